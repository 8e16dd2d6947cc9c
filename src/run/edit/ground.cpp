// SPDX-License-Identifier: Apache-2.0
// The ground is the plane that contains most of the level surfels of the background below
// a box: candidates from random samples of three surfels, scored as in MSAC (Torr and
// Zisserman 2000), then least squares.
#include <relidar/run/edit.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <vector>

#include <relidar/run/run.hpp>
#include "base/fail.hpp"
#include "base/geometry/plane_sums.hpp"
#include "base/median.hpp"
#include "base/random.hpp"

namespace relidar {
namespace {

// slopes up to 41 degrees, because normals are noisy
constexpr double kMinLevelNormalZ = 0.75;
// slopes up to 32 degrees
constexpr double kMinPlaneNormalZ = 0.85;
// Opacity 0.05. More transparent surfels do not form a surface.
constexpr double kMinOpacityLogit = -3.0;
// height difference divided by distance
constexpr double kMaxSightSlope = 0.25;
// Half the height of a kerb, because surfels above a kerb belong to another surface.
constexpr double kMaxPlaneDistance_m = 0.1;
// Distance in the least-squares fit: above the noise of street surfels, but excludes the
// foot of a wall.
constexpr double kMaxFitDistance_m = 0.05;
// Around the area below the box, tried in this order. Far from the sensor, a small area
// may contain no surfel, because rings are a metre apart.
constexpr std::array kSearchMargins_m{0.25, 0.5, 1.0};
// A slope cannot be measured in the small area below a pedestrian.
constexpr double kMinHalfWidth_m = 0.75;
constexpr std::size_t kMinSurfelsOnPlane = 8;  // Minimum number of surfels on a ground plane.
// Standard deviation along the narrow side. A narrower strip, for example a single LiDAR
// ring, does not determine the slope.
constexpr double kMinSpread_m = 0.15;
constexpr int kRansacDraws = 200;
// positions along a track at which the height above the ground is measured
constexpr int kClearanceSamples = 16;

struct GroundPlane {
    glm::dvec3 origin_m{0.0};
    glm::dvec3 normal{0.0, 0.0, 1.0};

    double height_at(const glm::dvec2& xy) const {
        return origin_m.z - (normal.x * (xy.x - origin_m.x) + normal.y * (xy.y - origin_m.y)) / normal.z;
    }
    double height_above(const glm::dvec3& point) const { return glm::dot(normal, point - origin_m); }
};

/// A rectangle in the x-y plane around the centre of the box.
struct Footprint {
    glm::dvec2 centre_m{0.0};
    double yaw_rad = 0.0;
    glm::dvec2 half_m{0.0};

    glm::dvec2 to_footprint(const glm::dvec3& point) const {
        const double c = std::cos(yaw_rad), s = std::sin(yaw_rad), dx = point.x - centre_m.x,
                     dy = point.y - centre_m.y;
        return {c * dx + s * dy, c * dy - s * dx};
    }
    bool contains_point(const glm::dvec3& point, double margin_m) const {
        const glm::dvec2 d = glm::abs(to_footprint(point));
        return d.x <= half_m.x + margin_m && d.y <= half_m.y + margin_m;
    }
};

const Pose& nearest_pose(const PoseTrack& sensor_track, const glm::dvec2& xy) {
    if (sensor_track.pose.empty())
        throw DataError(
            "cannot place an actor on the ground: the log has no poses of the vehicle, which are needed to "
            "find the ground");
    return *std::ranges::min_element(
        sensor_track.pose, {}, [&](const Pose& p) { return glm::distance(glm::dvec2(p.translation), xy); });
}

glm::dvec3 surfel_normal(const glm::vec4& rotation_wxyz) {
    return glm::normalize(glm::dquat(rotation_wxyz.x, rotation_wxyz.y, rotation_wxyz.z, rotation_wxyz.w)) *
           glm::dvec3(0.0, 0.0, 1.0);
}

/// If the background is stored in blocks, loads only the blocks near the given positions.
class HorizontalSurfels {
public:
    HorizontalSurfels(const SceneWithLogView& driving, const std::vector<glm::dvec2>& positions_xy)
        : sensor_track_(driving.sequence.lidar_track(0)) {
        add_surfels(driving.scene.surfels, driving.scene.models.front().count);
        for (const SceneBlock& block : driving.scene.blocks) {
            const auto is_near_block = [&](const glm::dvec2& p) {
                constexpr double kBlockReach_m = 20.0;  // half the length of the longest vehicle
                return glm::all(glm::greaterThan(p, glm::dvec2(block.low_m) - kBlockReach_m)) &&
                       glm::all(glm::lessThan(p, glm::dvec2(block.high_m) + kBlockReach_m));
            };
            if (std::ranges::any_of(positions_xy, is_near_block)) add_surfels(load_block(block), block.count);
        }
    }

    /// Returns the ground plane below a footprint, or nothing if there are too few level
    /// surfels. Ignores surfels far above the sensor, such as bridges and trees.
    std::optional<GroundPlane> fit_below(const Footprint& footprint) const {
        const glm::dvec3 sensor = nearest_pose(sensor_track_, footprint.centre_m).translation;
        const double highest_m =
            sensor.z + kMaxSightSlope * glm::distance(glm::dvec2(sensor), footprint.centre_m);
        for (const double margin_m : kSearchMargins_m) {
            std::vector<glm::dvec3> points;
            for (const glm::dvec3& p : points_)
                if (p.z < highest_m && footprint.contains_point(p, margin_m)) points.push_back(p);
            if (const std::optional<GroundPlane> plane = fit_plane(points, footprint, margin_m)) return plane;
        }
        return {};
    }

    std::string describe_nearest(const glm::dvec2& xy) const {
        if (points_.empty()) return "the background has no horizontal surfel";
        double nearest_m = std::numeric_limits<double>::infinity();
        for (const glm::dvec3& p : points_) nearest_m = std::min(nearest_m, glm::distance(glm::dvec2(p), xy));
        return fmt::format("the nearest horizontal surfel is {:.1f} m away", nearest_m);
    }

private:
    /// Adds the centres of surfels that are opaque and level enough to be ground.
    void add_surfels(const Surfels& surfels, std::size_t n_surfels) {
        const bool has_normals = properties_of(surfels.primitive).has_normals;
        for (std::size_t i = 0; i < n_surfels; ++i)
            if (surfels.opacity_logit[i] > kMinOpacityLogit &&
                (!has_normals || std::abs(surfel_normal(surfels.rotation[i]).z) > kMinLevelNormalZ))
                points_.emplace_back(surfels.mean[i]);
    }

    /// Returns the plane with the most points near it (RANSAC). Tests many planes, each
    /// through three random points. The score depends on the distances of all points.
    static GroundPlane ransac_plane(const std::vector<glm::dvec3>& points) {
        Random random(1);
        GroundPlane best{points.front(), {0.0, 0.0, 1.0}};
        double most = 0.0;
        for (int draw = 0; draw < kRansacDraws; ++draw) {
            const auto any = [&] { return points[random.next_uint64() % points.size()]; };
            const glm::dvec3 a = any(), b = any(), c = any();
            glm::dvec3 normal = glm::cross(b - a, c - a);
            const double length = glm::length(normal);
            // Rejects steep planes. Also rejects three points on a line, because they
            // define no plane.
            if (!(std::abs(normal.z) > kMinPlaneNormalZ * length)) continue;
            normal *= (normal.z > 0.0 ? 1.0 : -1.0) / length;
            const GroundPlane plane{a, normal};
            double score = 0.0;
            for (const glm::dvec3& p : points) {
                const double off = plane.height_above(p) / kMaxPlaneDistance_m;
                score += std::max(0.0, 1.0 - off * off);
            }
            if (score > most) {
                best = plane;
                most = score;
            }
        }
        return best;
    }

    /// Refines the RANSAC plane by three least-squares fits. Each fit uses the points
    /// near the plane of the previous fit.
    static std::optional<GroundPlane> fit_plane(const std::vector<glm::dvec3>& points,
                                                const Footprint& footprint, double footprint_margin_m) {
        if (points.size() < kMinSurfelsOnPlane) return {};
        GroundPlane plane = ransac_plane(points);
        for (int round = 0; round < 3; ++round) {
            std::vector<glm::dvec3> on;
            for (const glm::dvec3& p : points)
                if (std::abs(plane.height_above(p)) < kMaxFitDistance_m) on.push_back(p);
            if (on.size() < kMinSurfelsOnPlane) return {};
            PointMomentSums sums;
            for (const glm::dvec3& p : on) sums.add_point(p - points.front());
            const PlaneFit fit = sums.fit_plane();
            plane = {points.front() + fit.mean, fit.axes[0] * (fit.axes[0].z > 0.0 ? 1.0 : -1.0)};
            const glm::dvec2 beside = glm::abs(footprint.to_footprint(plane.origin_m));
            if (fit.variance[1] < kMinSpread_m * kMinSpread_m || plane.normal.z < kMinPlaneNormalZ) return {};
            // Rejects the plane if the centre of its surfels is far from the centre of
            // the area. The surfels then cover only one side of the area.
            const glm::dvec2 middle_m = 0.5 * (footprint.half_m + footprint_margin_m);
            if (beside.x > middle_m.x || beside.y > middle_m.y) return {};
        }
        return plane;
    }

    PoseTrack sensor_track_;
    std::vector<glm::dvec3> points_;
};

double heading_rad(const Pose& pose) {
    const glm::dvec3 ahead = pose.rotation * glm::dvec3(1.0, 0.0, 0.0);
    return std::atan2(ahead.y, ahead.x);
}

Footprint make_footprint(const glm::dvec2& centre_m, double yaw_rad, const glm::dvec3& box_size_m) {
    return {centre_m, yaw_rad, glm::max(0.5 * glm::dvec2(box_size_m), glm::dvec2(kMinHalfWidth_m))};
}

const BoxTrack& find_actor_box(const SceneWithLogView& scene_and_log_view, const std::string& track_id) {
    // Calls move_track() only because it throws an error if the track does not belong to
    // an actor. The moved track is not used.
    (void)move_track(SceneWithLog{strip_surfels(scene_and_log_view.scene), scene_and_log_view.sequence},
                     track_id, {});
    return *find_box(scene_and_log_view.sequence, track_id);
}

/// Returns the ground plane below the nearest actor whose box covers a position, or
/// nothing if no box does. Uses the pose of the box, because the actor hides the road
/// from the sensor.
/// @param get_box_clearance_m  returns the height of the bottom of a box above the ground
std::optional<GroundPlane> ground_below_box(
    const glm::dvec2& position_m, const Log& sequence,
    const std::function<double(const BoxTrack&)>& get_box_clearance_m) {
    const BoxTrack* nearest = nullptr;
    Pose at;
    double nearest_m = std::numeric_limits<double>::infinity();
    for (const BoxTrack& box : sequence.boxes)
        for (const Pose& pose : box.world_from_box.pose) {
            const double apart_m = glm::distance(glm::dvec2(pose.translation), position_m);
            const Footprint footprint{pose.translation, heading_rad(pose), 0.5 * glm::dvec2(box.size_m)};
            if (apart_m < nearest_m && footprint.contains_point(glm::dvec3(position_m, 0.0), 0.0)) {
                nearest = &box;
                at = pose;
                nearest_m = apart_m;
            }
        }
    if (!nearest) return {};
    const glm::dvec3 up = at.rotation * glm::dvec3(0.0, 0.0, 1.0);
    if (up.z < kMinPlaneNormalZ) return {};
    return GroundPlane{at.translation - (0.5 * nearest->size_m.z + get_box_clearance_m(*nearest)) * up, up};
}

/// Returns the height of a box's bottom above the ground in metres: the median over some
/// positions of its track.
std::optional<double> median_clearance_m(const SceneWithLogView& scene_and_log_view, const BoxTrack& box) {
    std::vector<glm::dvec2> positions_xy;
    const std::vector<Pose>& poses = box.world_from_box.pose;
    const std::size_t step = std::max<std::size_t>(1, poses.size() / kClearanceSamples);
    for (std::size_t i = 0; i < poses.size(); i += step) positions_xy.emplace_back(poses[i].translation);
    const HorizontalSurfels surfels(scene_and_log_view, positions_xy);
    std::vector<double> heights_m;
    for (std::size_t i = 0; i < poses.size(); i += step) {
        const Pose& pose = poses[i];
        const std::optional<GroundPlane> plane =
            surfels.fit_below(make_footprint(pose.translation, heading_rad(pose), box.size_m));
        if (plane) heights_m.push_back(plane->height_above(pose.translation) - 0.5 * box.size_m.z);
    }
    if (heights_m.empty()) return {};
    return compute_median(heights_m);
}

/// Returns the rotation of an actor that stands on a plane and faces the direction
/// `yaw_rad`.
glm::dquat rotate_to_plane(const GroundPlane& plane, double yaw_rad) {
    const glm::dvec2 level(std::cos(yaw_rad), std::sin(yaw_rad));
    const double climb = -(plane.normal.x * level.x + plane.normal.y * level.y) / plane.normal.z;
    const glm::dvec3 ahead = glm::normalize(glm::dvec3(level, climb));
    return glm::normalize(glm::quat_cast(glm::dmat3(ahead, glm::cross(plane.normal, ahead), plane.normal)));
}

}  // namespace

std::optional<double> ground_clearance(const SceneWithLogView& actor_scene, const std::string& track) {
    return median_clearance_m(actor_scene, find_actor_box(actor_scene, track));
}

/// Places an actor on the ground at its start, and at each frame if it moves. First fits
/// a plane to surfels, then uses a box that covers the position.
NewActorMotion stand_on_ground(const SceneWithLogView& target_scene, const GroundPlacement& placement,
                               const SceneWithLogView& actor_scene, const std::string& actor_track) {
    const Log& sequence = target_scene.sequence;
    const BoxTrack& box = find_actor_box(actor_scene, actor_track);
    const glm::dvec3 offset_m = sequence.world_offset_m;
    const glm::dvec2 xy = placement.dataset_m - glm::dvec2(offset_m);
    const double yaw_rad =
        placement.yaw_rad ? *placement.yaw_rad : heading_rad(nearest_pose(sequence.world_from_vehicle, xy));
    std::vector<double> times_s;
    if (placement.speed_mps != 0.0)
        for (const Frame& frame : sequence.frames)  // LiDARs that sweep together have the same time
            if (times_s.empty() || frame.time_s > times_s.back()) times_s.push_back(frame.time_s);
    std::vector<glm::dvec2> positions{xy};
    for (const double time_s : times_s)
        positions.push_back(xy + placement.speed_mps * (time_s - times_s.front()) *
                                     glm::dvec2(std::cos(yaw_rad), std::sin(yaw_rad)));

    const HorizontalSurfels surfels(target_scene, positions);
    const auto ground_at = [&](const glm::dvec2& position_m) {
        const std::optional<GroundPlane> plane =
            surfels.fit_below(make_footprint(position_m, yaw_rad, box.size_m));
        if (plane) return plane;
        return ground_below_box(position_m, sequence, [&](const BoxTrack& other_box) {
            return median_clearance_m(target_scene, other_box).value_or(0.0);
        });
    };
    std::optional<GroundPlane> plane = ground_at(xy);
    if (!plane)
        fail<UsageError>(
            "cannot place {} on the ground at {:.6g},{:.6g} in the dataset's world: the background has no "
            "surface below its box ({}); choose a position on a surface that the log has observed",
            actor_track, placement.dataset_m.x, placement.dataset_m.y, surfels.describe_nearest(xy));
    const std::optional<double> clearance_m =
        placement.clearance_m ? placement.clearance_m : ground_clearance(actor_scene, actor_track);
    const double above_m = 0.5 * box.size_m.z + clearance_m.value_or(0.0);
    const auto pose_on = [&](const GroundPlane& ground, const glm::dvec2& position_m) {
        const glm::dvec3 centre_m(position_m, ground.height_at(position_m) + above_m / ground.normal.z);
        return Pose{rotate_to_plane(ground, yaw_rad), centre_m + offset_m};
    };
    NewActorMotion start{pose_on(*plane, xy), placement.speed_mps};
    // Where the ground was not observed, the mean direction is used, because a single
    // normal is noisy.
    glm::dvec3 normal_sum = plane->normal;
    for (std::size_t i = 0; i < times_s.size(); ++i) {
        const glm::dvec2& position_m = positions[i + 1];
        if (const std::optional<GroundPlane> next = ground_at(position_m)) {
            plane = next;
            normal_sum += next->normal;
        } else {
            start.unseen_m += glm::distance(position_m, positions[i]);
            plane = GroundPlane{{positions[i], plane->height_at(positions[i])}, glm::normalize(normal_sum)};
        }
        start.dataset_path.time_s.push_back(times_s[i]);
        start.dataset_path.pose.push_back(pose_on(*plane, position_m));
    }
    return start;
}

}  // namespace relidar
