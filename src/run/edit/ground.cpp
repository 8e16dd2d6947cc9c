// SPDX-License-Identifier: Apache-2.0
// The ground is the plane that contains most of the level surfels of the background below
// a box: candidates from random samples of three surfels, scored as in MSAC (Torr and
// Zisserman 2000), then least squares. A path begins at the log's vehicle, which stands
// on the ground. Each next plane is near the plane before it, so a path never climbs a
// car.
#include <relidar/run/edit.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <vector>

#include <relidar/run/run.hpp>
#include "base/fail.hpp"
#include "base/geometry/plane_sums.hpp"
#include "base/median.hpp"
#include "base/random.hpp"
#include "run/edit/tracks.hpp"

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
// In the least-squares fit: above the noise of street surfels, below the foot of a wall.
constexpr double kMaxFitDistance_m = 0.05;
// Around the area below the box, tried in this order. Far from the sensor, a small area
// may contain no surfel, because rings are a metre apart.
constexpr std::array kSearchMargins_m{0.25, 0.5, 1.0};
// A slope cannot be measured in the small area below a pedestrian.
constexpr double kMinHalfWidth_m = 0.75;
constexpr std::size_t kMinSurfelsOnPlane = 8;
// Standard deviation along the narrow side. A narrower strip, for example a single LiDAR
// ring, does not determine the slope.
constexpr double kMinSpread_m = 0.15;
constexpr int kRansacDraws = 200;
// positions along a track at which the height above the ground is measured
constexpr int kClearanceSamples = 16;
// Largest step between two points of a path at which the ground is searched.
constexpr double kGroundStep_m = 1.0;
// Largest distance of a surfel from the expected ground: above a kerb, below a bonnet. It
// grows with the length of path whose ground is hidden, because slopes change.
constexpr double kMaxGroundJump_m = 0.25, kJumpPerHidden = 0.05;
// Longest hidden path across which the ground below an object is computed.
constexpr double kMaxHidden_m = 10.0;
// Surfels that are higher above the bottom of a labelled object belong to the object.
// Labels are this much smaller than their object.
constexpr double kObjectFoot_m = 0.3, kLabelMargin_m = 0.2;

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
    double reach_m() const { return glm::length(half_m); }
    bool contains_point(const glm::dvec3& point, double margin_m) const {
        const glm::dvec2 d = glm::abs(to_footprint(point));
        return d.x <= half_m.x + margin_m && d.y <= half_m.y + margin_m;
    }
};

const Pose& nearest_pose(const PoseTrack& sensor_track, const glm::dvec2& xy) {
    if (sensor_track.pose.empty())
        fail("cannot place an actor on the ground: found no poses of the vehicle, expected at least one");
    return *std::ranges::min_element(
        sensor_track.pose, {}, [&](const Pose& p) { return glm::distance(glm::dvec2(p.translation), xy); });
}

glm::dvec3 surfel_normal(const glm::vec4& rotation_wxyz) {
    return glm::normalize(glm::dquat(rotation_wxyz.x, rotation_wxyz.y, rotation_wxyz.z, rotation_wxyz.w)) *
           glm::dvec3(0.0, 0.0, 1.0);
}

/// Surfels on which an actor can stand. Leaves out labelled objects that stand still. If
/// the background is stored in blocks, loads only the blocks near the given positions.
class HorizontalSurfels {
public:
    HorizontalSurfels(const SceneWithLogView& driving, const std::vector<glm::dvec2>& positions_xy)
        : sensor_track_(driving.log.lidar_track(0)) {
        // The poses of an object that stands still are nearly equal.
        for (const BoxTrack& box : driving.log.boxes)
            if (!box.world_from_box.pose.empty() && !box.is_moving())
                standing_.push_back(
                    {inverse(box.world_from_box.pose[box.world_from_box.pose.size() / 2]), 0.5 * box.size_m});
        add_surfels(driving.scene.surfels, driving.scene.models.front().count);
        for (const SceneBlock& block : driving.scene.blocks) {
            const auto is_near_block = [&](const glm::dvec2& p) {
                constexpr double kBlockReach_m = 20.0;  // half the length of the longest vehicle
                return glm::all(glm::greaterThan(p, glm::dvec2(block.low_m) - kBlockReach_m)) &&
                       glm::all(glm::lessThan(p, glm::dvec2(block.high_m) + kBlockReach_m));
            };
            if (std::ranges::any_of(positions_xy, is_near_block)) add_surfels(load_block(block), block.count);
        }
        // Searches use the points in this order.
        std::ranges::sort(points_, {}, &glm::dvec3::x);
    }

    /// A plane near which the ground is expected, and the largest distance from it.
    struct ExpectedGround {
        GroundPlane plane;
        double max_distance_m;
    };

    /// Returns the ground plane below a footprint, or nothing if there are too few level
    /// surfels. Ignores surfels far above the sensor, such as bridges and trees.
    /// @param expected  ignores surfels far from this plane, if it is known
    std::optional<GroundPlane> fit_below(const Footprint& footprint,
                                         const std::optional<ExpectedGround>& expected = {}) const {
        const glm::dvec3 sensor = nearest_pose(sensor_track_, footprint.centre_m).translation;
        const double highest_m =
            sensor.z + kMaxSightSlope * glm::distance(glm::dvec2(sensor), footprint.centre_m);
        const auto is_candidate = [&](const glm::dvec3& p) {
            return p.z < highest_m &&
                   (!expected || std::abs(expected->plane.height_above(p)) < expected->max_distance_m);
        };
        for (const double margin_m : kSearchMargins_m) {
            // `points_` is sorted by x.
            const double reach_m = footprint.reach_m() + 2.0 * margin_m;
            const auto first =
                std::ranges::lower_bound(points_, footprint.centre_m.x - reach_m, {}, &glm::dvec3::x);
            std::vector<glm::dvec3> points;
            for (auto p = first; p != points_.end() && p->x <= footprint.centre_m.x + reach_m; ++p)
                if (footprint.contains_point(*p, margin_m) && is_candidate(*p)) points.push_back(*p);
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
                (!has_normals || std::abs(surfel_normal(surfels.rotation[i]).z) > kMinLevelNormalZ) &&
                !is_on_object(glm::dvec3(surfels.mean[i])))
                points_.emplace_back(surfels.mean[i]);
    }

    bool is_on_object(const glm::dvec3& point) const {
        return std::ranges::any_of(standing_, [&](const StandingBox& box) {
            const glm::dvec3 p = box.box_from_world * point, apart = glm::abs(p) - box.half_m;
            return apart.x < kLabelMargin_m && apart.y < kLabelMargin_m && apart.z < kLabelMargin_m &&
                   p.z > kObjectFoot_m - box.half_m.z;
        });
    }

    /// Returns the best of many planes through three random points (RANSAC). Its score is
    /// the sum over all points of max(0, 1 - (distance / kMaxPlaneDistance_m)^2).
    static GroundPlane ransac_plane(const std::vector<glm::dvec3>& points) {
        Random random(1);
        GroundPlane best_plane{points.front(), {0.0, 0.0, 1.0}};
        double best_score = 0.0;
        for (int draw = 0; draw < kRansacDraws; ++draw) {
            const auto random_point = [&] { return points[random.next_uint64() % points.size()]; };
            const glm::dvec3 a = random_point(), b = random_point(), c = random_point();
            glm::dvec3 normal = glm::cross(b - a, c - a);
            const double length = glm::length(normal);
            // Rejects steep planes, and points on a line, which define no plane.
            if (!(std::abs(normal.z) > kMinPlaneNormalZ * length)) continue;
            normal *= (normal.z > 0.0 ? 1.0 : -1.0) / length;
            const GroundPlane plane{a, normal};
            double score = 0.0;
            for (const glm::dvec3& p : points) {
                const double relative_distance = plane.height_above(p) / kMaxPlaneDistance_m;
                score += std::max(0.0, 1.0 - relative_distance * relative_distance);
            }
            if (score > best_score) {
                best_plane = plane;
                best_score = score;
            }
        }
        return best_plane;
    }

    /// Refines the RANSAC plane by three least-squares fits. Each fit uses the points
    /// near the plane of the previous fit.
    static std::optional<GroundPlane> fit_plane(const std::vector<glm::dvec3>& points,
                                                const Footprint& footprint, double footprint_margin_m) {
        if (points.size() < kMinSurfelsOnPlane) return {};
        GroundPlane plane = ransac_plane(points);
        for (int round = 0; round < 3; ++round) {
            std::vector<glm::dvec3> near_points;
            for (const glm::dvec3& p : points)
                if (std::abs(plane.height_above(p)) < kMaxFitDistance_m) near_points.push_back(p);
            if (near_points.size() < kMinSurfelsOnPlane) return {};
            PointMomentSums sums;
            for (const glm::dvec3& p : near_points) sums.add_point(p - points.front());
            const PlaneFit fit = sums.fit_plane();
            plane = {points.front() + fit.mean, fit.axes[0] * (fit.axes[0].z > 0.0 ? 1.0 : -1.0)};
            const glm::dvec2 distance_m = glm::abs(footprint.to_footprint(plane.origin_m));
            if (fit.variance[1] < kMinSpread_m * kMinSpread_m || plane.normal.z < kMinPlaneNormalZ) return {};
            // Rejects the plane if the centre of its surfels is far from the centre of
            // the area. The surfels then cover only one side of the area.
            const glm::dvec2 max_distance_m = 0.5 * (footprint.half_m + footprint_margin_m);
            if (distance_m.x > max_distance_m.x || distance_m.y > max_distance_m.y) return {};
        }
        return plane;
    }

    struct StandingBox {
        Pose box_from_world;
        glm::dvec3 half_m;
    };
    PoseTrack sensor_track_;
    std::vector<StandingBox> standing_;
    std::vector<glm::dvec3> points_;
};

double heading_rad(const Pose& pose) {
    const glm::dvec3 ahead = pose.rotation * glm::dvec3(1.0, 0.0, 0.0);
    return std::atan2(ahead.y, ahead.x);
}

Footprint make_footprint(const glm::dvec2& centre_m, double yaw_rad, const glm::dvec3& box_size_m) {
    return {centre_m, yaw_rad, glm::max(0.5 * glm::dvec2(box_size_m), glm::dvec2(kMinHalfWidth_m))};
}

struct BoxPose {
    const BoxTrack* box;
    Pose world_from_box;
};

/// Returns the box that covers a position in the x-y plane at any time of the log, and
/// its pose there. Of several poses, returns the one whose centre is nearest.
std::optional<BoxPose> find_covering_box(const glm::dvec2& position_m, const Log& log) {
    std::optional<BoxPose> nearest;
    double nearest_m = std::numeric_limits<double>::infinity();
    for (const BoxTrack& box : log.boxes)
        for (const Pose& pose : box.world_from_box.pose) {
            const double distance_m = glm::distance(glm::dvec2(pose.translation), position_m);
            const Footprint footprint{pose.translation, heading_rad(pose), 0.5 * glm::dvec2(box.size_m)};
            if (distance_m >= nearest_m || !footprint.contains_point(glm::dvec3(position_m, 0.0), 0.0))
                continue;
            nearest = {&box, pose};
            nearest_m = distance_m;
        }
    return nearest;
}

/// Returns the height of a box's bottom above the ground in metres: the median over about
/// kClearanceSamples poses of its track. Returns nothing without ground below the box.
std::optional<double> median_clearance_m(const SceneWithLogView& scene_and_log_view, const BoxTrack& box) {
    const std::vector<Pose>& all = box.world_from_box.pose;
    std::vector<Pose> poses;
    std::vector<glm::dvec2> positions_xy;
    const std::size_t step = std::max<std::size_t>(1, all.size() / kClearanceSamples);
    for (std::size_t i = 0; i < all.size(); i += step) {
        poses.push_back(all[i]);
        positions_xy.emplace_back(all[i].translation);
    }
    const HorizontalSurfels surfels(scene_and_log_view, positions_xy);
    std::vector<double> heights_m;
    for (const Pose& pose : poses) {
        const std::optional<GroundPlane> plane =
            surfels.fit_below(make_footprint(pose.translation, heading_rad(pose), box.size_m));
        if (plane) heights_m.push_back(plane->height_above(pose.translation) - 0.5 * box.size_m.z);
    }
    return heights_m.empty() ? std::nullopt : std::optional(compute_median(heights_m));
}

/// Returns the rotation of an actor on a plane that faces the direction `yaw_rad`.
glm::dquat rotate_to_plane(const GroundPlane& plane, double yaw_rad) {
    const glm::dvec2 level(std::cos(yaw_rad), std::sin(yaw_rad));
    const double climb = -(plane.normal.x * level.x + plane.normal.y * level.y) / plane.normal.z;
    const glm::dvec3 ahead = glm::normalize(glm::dvec3(level, climb));
    return glm::normalize(glm::quat_cast(glm::dmat3(ahead, glm::cross(plane.normal, ahead), plane.normal)));
}

struct PathPoint {
    glm::dvec2 position_m{0.0};
    double yaw_rad = 0.0;
};

struct PathGround {
    std::optional<GroundPlane> plane;  ///< no value if nothing near the path was observed
    bool is_observed = false;          ///< false if `plane` continues the ground before it
};

/// Adds points between `start` and the points of a path, so that they are at most
/// kGroundStep_m apart. Returns all points, and the index in them of each path point.
std::pair<std::vector<PathPoint>, std::vector<std::size_t>> subdivide_path(
    const PathPoint& start, const std::vector<PathPoint>& path) {
    std::vector<PathPoint> points{start};
    std::vector<std::size_t> index_of_path_point;
    for (const PathPoint& next : path) {
        const glm::dvec2 from_m = points.back().position_m, offset_m = next.position_m - from_m;
        const int n_steps = int(std::ceil(glm::length(offset_m) / kGroundStep_m));
        for (int k = 1; k <= n_steps; ++k)
            points.push_back({from_m + offset_m * (double(k) / n_steps), next.yaw_rad});
        index_of_path_point.push_back(points.size() - 1);
    }
    return {points, index_of_path_point};
}

/// Interpolates the ground linearly where it was not observed between two observed
/// points, so that the path has no step where the ground appears again.
void join_gaps(std::vector<PathGround>& ground, const std::vector<PathPoint>& points) {
    std::optional<std::size_t> before;  // last observed point before `after`, if any
    for (std::size_t after = 0; after < ground.size(); ++after) {
        if (!ground[after].is_observed) continue;
        for (std::size_t k = before ? *before + 1 : after; k < after; ++k) {
            const GroundPlane &first = *ground[*before].plane, &last = *ground[after].plane;
            const double share = double(k - *before) / double(after - *before);
            const double z = glm::mix(first.height_at(points[*before].position_m),
                                      last.height_at(points[after].position_m), share);
            ground[k].plane = GroundPlane{{points[k].position_m, z},
                                          glm::normalize(glm::mix(first.normal, last.normal, share))};
        }
        before = after;
    }
}

/// Finds the ground along paths in a scene.
class GroundFinder {
public:
    GroundFinder(const SceneWithLogView& target, const std::vector<PathPoint>& path)
        : target_(target), surfels_(target, positions_near(target, path)) {}

    const HorizontalSurfels& surfels() const { return surfels_; }

    /// Returns the ground below each point of a path. Searches from the log's vehicle to
    /// the first point, and then along the path.
    std::vector<PathGround> follow_path(const std::vector<PathPoint>& path, const glm::dvec3& size_m) const {
        const Pose& vehicle = nearest_pose(target_.log.lidar_track(0), path.front().position_m);
        const auto [points, index] =
            subdivide_path({glm::dvec2(vehicle.translation), heading_rad(vehicle)}, path);
        std::vector<PathGround> ground;
        // Hidden ground continues with the mean direction of the normals observed so far,
        // because a single normal is noisy.
        glm::dvec3 normal_sum(0.0);
        double hidden_m = 0.0;  // length of path since the last observed ground
        for (std::size_t i = 0; i < points.size(); ++i) {
            const glm::dvec2& position_m = points[i].position_m;
            PathGround here;
            if (i > 0 && ground.back().plane) {
                const double step_m = glm::distance(position_m, points[i - 1].position_m);
                here.plane = ground.back().plane;
                if (!ground.back().is_observed)
                    here.plane = GroundPlane{
                        {points[i - 1].position_m, here.plane->height_at(points[i - 1].position_m)},
                        glm::normalize(normal_sum)};
                hidden_m = ground.back().is_observed ? step_m : hidden_m + step_m;
            }
            const Footprint footprint = make_footprint(position_m, points[i].yaw_rad, size_m);
            std::optional<GroundPlane> found = find_near(footprint, here.plane, hidden_m);
            if (!found && here.plane && i == index.front()) found = restart(footprint, *here.plane, hidden_m);
            here.is_observed = found.has_value();
            if (found) {
                here.plane = found;
                normal_sum += found->normal;
            }
            ground.push_back(here);
        }
        join_gaps(ground, points);
        std::vector<PathGround> of_path;
        for (const std::size_t i : index) of_path.push_back(ground[i]);
        return of_path;
    }

private:
    SceneWithLogView target_;
    HorizontalSurfels surfels_;
    mutable std::map<std::string, double> clearance_m_;  ///< by the ids of boxes, because it is slow

    static std::vector<glm::dvec2> positions_near(const SceneWithLogView& target,
                                                  const std::vector<PathPoint>& path) {
        std::vector<glm::dvec2> positions;
        for (const PathPoint& point : path) positions.push_back(point.position_m);
        positions.emplace_back(nearest_pose(target.log.lidar_track(0), positions.front()).translation);
        return positions;
    }

    /// Returns the plane on which the actor at a position stands, because it hides the
    /// road from the sensor. Returns nothing if no box covers the position at any time.
    std::optional<GroundPlane> ground_below_box(const glm::dvec2& position_m) const {
        const std::optional<BoxPose> covering = find_covering_box(position_m, target_.log);
        if (!covering) return {};
        const auto& [box, world_from_box] = *covering;
        const glm::dvec3 up = world_from_box.rotation * glm::dvec3(0.0, 0.0, 1.0);
        if (up.z < kMinPlaneNormalZ) return {};
        const auto [clearance_m, is_new] = clearance_m_.try_emplace(box->id, 0.0);
        if (is_new) clearance_m->second = median_clearance_m(target_, *box).value_or(0.0);
        const double centre_height_m = 0.5 * box->size_m.z + clearance_m->second;
        return GroundPlane{world_from_box.translation - centre_height_m * up, up};
    }

    /// Returns the ground below a footprint: a plane that is fitted to surfels, or the
    /// ground below a box that covers the position. Both must be near the expected plane.
    std::optional<GroundPlane> find_near(const Footprint& footprint,
                                         const std::optional<GroundPlane>& expected, double hidden_m) const {
        const double most_m = kMaxGroundJump_m + kJumpPerHidden * hidden_m;
        using Expected = std::optional<HorizontalSurfels::ExpectedGround>;
        const Expected near = expected ? Expected({*expected, most_m}) : Expected();
        if (const auto plane = surfels_.fit_below(footprint, near)) return plane;
        const auto below = ground_below_box(footprint.centre_m);
        const auto height_m = [&](const GroundPlane& plane) { return plane.height_at(footprint.centre_m); };
        return below && expected && std::abs(height_m(*below) - height_m(*expected)) > most_m ? std::nullopt
                                                                                              : below;
    }

    /// Returns the ground at the start of a path, if none is near the expected ground. A
    /// higher surface is an object on the ground, unless the ground is hidden for long.
    std::optional<GroundPlane> restart(const Footprint& footprint, const GroundPlane& expected,
                                       double hidden_m) const {
        const std::optional<GroundPlane> fit = surfels_.fit_below(footprint);
        if (!fit || hidden_m > kMaxHidden_m) return fit;
        const double z = expected.height_at(footprint.centre_m);
        return fit->height_at(footprint.centre_m) < z ? *fit
                                                      : GroundPlane{{footprint.centre_m, z}, expected.normal};
    }
};

/// Points of a path in relidar's world frame.
std::vector<PathPoint> list_path_points(const PoseTrack& dataset_path, const glm::dvec3& world_offset_m) {
    std::vector<PathPoint> points;
    for (const Pose& pose : dataset_path.pose)
        points.push_back({glm::dvec2(pose.translation - world_offset_m), heading_rad(pose)});
    return points;
}

/// Returns the motion of an actor along a path: replaces the heights of the path by those
/// of the ground, and tilts the box to the slope of the ground.
/// @param path  positions and headings in the dataset's world
/// @param clearance_m  height of the bottom above the ground; default: as in its scene
NewActorMotion place_path(const SceneWithLogView& target_scene, const PoseTrack& path,
                          std::optional<double> clearance_m, const SceneWithLogView& actor_scene,
                          const std::string& actor_track) {
    const BoxTrack& box = find_actor_box(actor_scene, actor_track);
    const glm::dvec3 offset_m = target_scene.log.world_offset_m;
    // In the world frame of the log: that of the dataset minus `offset_m`.
    const std::vector<PathPoint> points = list_path_points(path, offset_m);
    const GroundFinder finder(target_scene, points);
    const std::vector<PathGround> ground = finder.follow_path(points, box.size_m);
    const glm::dvec2 start_m = points.front().position_m;
    if (!ground.front().is_observed)
        fail<UsageError>(
            "cannot place {} on the ground at {:.6g},{:.6g} in the dataset's world: the background has no "
            "surface below its box ({}); choose a position on a surface that the log has observed",
            actor_track, start_m.x + offset_m.x, start_m.y + offset_m.y,
            finder.surfels().describe_nearest(start_m));
    if (!clearance_m) clearance_m = median_clearance_m(actor_scene, box);
    // Distance of the box centre from the ground plane, along its normal. Without ground
    // in the scene of the actor, the box stands on the ground.
    const double centre_height_m = 0.5 * box.size_m.z + clearance_m.value_or(0.0);
    NewActorMotion motion;
    for (std::size_t i = 0; i < points.size(); ++i) {
        const glm::dvec2& position_m = points[i].position_m;
        const GroundPlane& plane = *ground[i].plane;
        // The vertical distance is longer than the distance along the normal.
        const double z_m = plane.height_at(position_m) + centre_height_m / plane.normal.z;
        motion.dataset_path.append(path.time_s[i], {rotate_to_plane(plane, points[i].yaw_rad),
                                                    glm::dvec3(position_m, z_m) + offset_m});
        // Adds up the way over ground that was not observed. The first point is observed.
        if (!ground[i].is_observed) motion.unseen_m += glm::distance(position_m, points[i - 1].position_m);
    }
    motion.dataset_from_box = motion.dataset_path.pose.front();
    return motion;
}

}  // namespace

std::optional<double> ground_clearance(const SceneWithLogView& actor_scene, const std::string& track) {
    return median_clearance_m(actor_scene, find_actor_box(actor_scene, track));
}

std::vector<std::optional<double>> heights_above_ground(const SceneWithLogView& scene,
                                                        const PoseTrack& dataset_path,
                                                        const glm::dvec3& size_m) {
    const glm::dvec3 offset_m = scene.log.world_offset_m;
    std::vector<std::optional<double>> heights_m(dataset_path.pose.size());
    if (heights_m.empty()) return heights_m;
    const std::vector<PathPoint> points = list_path_points(dataset_path, offset_m);
    const std::vector<PathGround> ground = GroundFinder(scene, points).follow_path(points, size_m);
    for (std::size_t i = 0; i < ground.size(); ++i) {
        const Pose& pose = dataset_path.pose[i];
        // centre of the bottom of the box, moved to the world frame of the log
        const glm::dvec3 bottom_m = pose * glm::dvec3(0.0, 0.0, -0.5 * size_m.z) - offset_m;
        if (ground[i].is_observed) heights_m[i] = ground[i].plane->height_above(bottom_m);
    }
    return heights_m;
}

NewActorMotion follow_ground(const SceneWithLogView& target_scene, const PoseTrack& dataset_path,
                             std::optional<double> clearance_m, const SceneWithLogView& actor_scene,
                             const std::string& actor_track) {
    const double step_s = std::max(target_scene.log.lidars[0].sweep_period_s(), 1e-3);
    return place_path(target_scene, densify_track(dataset_path, step_s), clearance_m, actor_scene,
                      actor_track);
}

NewActorMotion stand_on_ground(const SceneWithLogView& target_scene, const GroundPlacement& placement,
                               const SceneWithLogView& actor_scene, const std::string& actor_track) {
    const Log& log = target_scene.log;
    const bool is_moving = placement.speed_mps != 0.0;
    const glm::dvec2 xy = placement.dataset_m - glm::dvec2(log.world_offset_m);
    const double yaw_rad =
        placement.yaw_rad ? *placement.yaw_rad : heading_rad(nearest_pose(log.world_from_vehicle, xy));
    const glm::dquat rotation = make_rotation(yaw_rad, 0.0, 0.0);
    const glm::dvec3 start_m(placement.dataset_m, 0.0), ahead(std::cos(yaw_rad), std::sin(yaw_rad), 0.0);
    const std::vector<double> times_s = list_sweep_times_s(log);
    PoseTrack path;  // a straight line; place_path() sets z
    for (const double time_s : times_s)
        path.append(time_s, {rotation, start_m + placement.speed_mps * (time_s - times_s.front()) * ahead});
    if (!is_moving || path.time_s.empty()) path = {{0.0}, {{rotation, start_m}}};
    NewActorMotion start = place_path(target_scene, path, placement.clearance_m, actor_scene, actor_track);
    start.speed_mps = placement.speed_mps;
    if (!is_moving) start.dataset_path = {};  // the start pose is enough
    return start;
}

}  // namespace relidar
