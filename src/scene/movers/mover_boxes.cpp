// SPDX-License-Identifier: Apache-2.0
// Fits a box to each track of a moving object. Uses the end of the object that faces the
// sensor, because it is the only end that the sensor reliably sees.

#include <cmath>

#include "base/median.hpp"
#include "scene/movers/mover_tracks.hpp"

namespace relidar {
namespace {

// Number of corrections of a path. The centre of the visible points, which the first path
// follows, shifts when other sides of the object become visible.
constexpr int kPathCorrections = 3;
constexpr double kTopWindow_s = 1.0;   // the top is the highest return so long before and after a frame
constexpr double kBoxMargin_m = 0.1;   // added around the points of a box
constexpr double kBoxGround_m = 0.15;  // extends boxes downwards; actors.cpp treats this part as ground
constexpr double kSpeedWindow_s = 0.5;
constexpr std::size_t kLabelsPerEnd = 10;  // labels that give the offset between box and visible points
// If the sensor is farther than this outside a box along one axis of the box, it sees
// only the near end of the object along this axis.
constexpr double kMinSideDistance_m = 0.5;

/// Position and heading of an object on the ground. They define the frame of the object.
struct GroundPose {
    glm::dvec3 position_m{0.0};
    double yaw = 0.0;
    glm::dvec3 forward_axis() const { return {std::cos(yaw), std::sin(yaw), 0.0}; }
    glm::dvec3 lateral_axis() const { return {-std::sin(yaw), std::cos(yaw), 0.0}; }
    glm::dquat orientation() const { return {std::cos(0.5 * yaw), 0.0, 0.0, std::sin(0.5 * yaw)}; }
    /// x along the heading, y to the left
    glm::dvec3 to_object(const glm::dvec3& world_point_m) const {
        const glm::dvec3 d = world_point_m - position_m;
        return {glm::dot(forward_axis(), d), glm::dot(lateral_axis(), d), d.z};
    }
    glm::dvec3 to_world(const glm::dvec3& local_point_m) const {
        return position_m + local_point_m.x * forward_axis() + local_point_m.y * lateral_axis() +
               glm::dvec3(0.0, 0.0, local_point_m.z);
    }
};
using GroundPath = std::vector<GroundPose>;  ///< [observations of a track]

double yaw_of(const Pose& pose) {
    const glm::dvec3 forward = pose.rotation * glm::dvec3(1.0, 0.0, 0.0);
    return std::atan2(forward.y, forward.x);
}

/// Returns the ground poses of an object that drives along these positions.
GroundPath add_headings(const std::vector<glm::dvec3>& positions_m) {
    const std::vector<double> yaw = path_headings_rad(positions_m);
    GroundPath poses;
    for (std::size_t k = 0; k < positions_m.size(); ++k) poses.push_back({positions_m[k], yaw[k]});
    return poses;
}

/// Returns the ground poses at the times when the LiDAR hit the object.
GroundPath poses_at_returns(const KinematicPath& path) {
    std::vector<glm::dvec3> positions_m;
    for (const KinematicState& state : path) positions_m.push_back(state.position_m);
    return add_headings(positions_m);
}

/// Returns the ground poses at the reference times of the frames, to which scans refer.
GroundPath poses_at_frames(const KinematicPath& path, const MoverTrack& track) {
    std::vector<glm::dvec3> positions_m;
    for (std::size_t k = 0; k < path.size(); ++k) {
        const MoverObservation& observation = track.observations[k];
        positions_m.push_back(path[k].position_after(observation.frame_time_s - observation.cluster.time_s));
    }
    return add_headings(positions_m);
}

struct Extent {
    double low_m, high_m;
};
/// Returns the interval that the points of an observation cover along an axis, without
/// the outermost 0.5 % of the points at each end.
Extent extent_along(const MoverCluster& cluster, const glm::dvec3& axis) {
    std::vector<double> values;
    for (const glm::dvec3& p : cluster.points_m) values.push_back(glm::dot(axis, p));
    std::sort(values.begin(), values.end());
    const std::size_t cut = values.size() / 200;
    return {values[cut], values[values.size() - 1 - cut]};
}

/// Returns the position of an object's centre along an axis, for each observation. Only
/// the end that faces the sensor is reliably visible. The centre is half the object's
/// size behind this end.
/// @param axes [observations] axis of the object, world frame
/// @param size_m size along the axis; if empty, the 90th percentile of the visible sizes
std::vector<double> centres_along(const MoverTrack& track, const std::vector<glm::dvec3>& axes,
                                  std::optional<double> size_m) {
    std::vector<Extent> extents;
    std::vector<double> lengths_m, centres_m;
    for (std::size_t k = 0; k < axes.size(); ++k) {
        extents.push_back(extent_along(track.observations[k].cluster, axes[k]));
        lengths_m.push_back(extents[k].high_m - extents[k].low_m);
    }
    std::sort(lengths_m.begin(), lengths_m.end());
    const double half_size_m = 0.5 * size_m.value_or(lengths_m[lengths_m.size() * 9 / 10]);
    for (std::size_t k = 0; k < axes.size(); ++k) {
        const Extent& extent = extents[k];
        const double sensor_m = glm::dot(axes[k], track.observations[k].sensor_m);
        // If the sensor is beside the object, both ends are visible.
        double centre_m = 0.5 * (extent.low_m + extent.high_m);
        if (sensor_m > extent.high_m) centre_m = extent.high_m - half_size_m;
        else if (sensor_m < extent.low_m) centre_m = extent.low_m + half_size_m;
        centres_m.push_back(centre_m);
    }
    return centres_m;
}

/// Returns the height of the object's top for each observation. Beams can miss the top of
/// a distant object, so neighbouring observations count too.
std::vector<double> top_heights_m(const MoverTrack& track) {
    std::vector<double> tops_m, result;
    for (const MoverObservation& o : track.observations)
        tops_m.push_back(extent_along(o.cluster, {0.0, 0.0, 1.0}).high_m);
    for (const MoverObservation& o : track.observations) {
        double highest_m = -1e30;
        for (std::size_t j = 0; j < tops_m.size(); ++j)
            if (std::abs(track.observations[j].cluster.time_s - o.cluster.time_s) < kTopWindow_s)
                highest_m = std::max(highest_m, tops_m[j]);
        result.push_back(highest_m);
    }
    return result;
}

/// Returns the position of the object in each observation: its centre in x and y, and its
/// top in z.
/// @param size_m length and width; if empty, the visible size is used
std::vector<glm::dvec3> place_object(const MoverTrack& track, const GroundPath& poses,
                                     std::optional<glm::dvec2> size_m = {}) {
    std::vector<glm::dvec3> forward, lateral;  // [observations] horizontal axes
    std::vector<glm::dvec3> positions_m;       // [observations]
    for (const GroundPose& p : poses) {
        forward.push_back(p.forward_axis());
        lateral.push_back(p.lateral_axis());
    }
    // World coordinates of the centre along these axes, and along z.
    const auto size_along = [&](int axis) { return size_m ? std::optional((*size_m)[axis]) : std::nullopt; };
    const std::vector<double> along = centres_along(track, forward, size_along(0)),
                              across = centres_along(track, lateral, size_along(1));
    const std::vector<double> top = top_heights_m(track);
    for (std::size_t k = 0; k < poses.size(); ++k)
        positions_m.push_back(along[k] * forward[k] + across[k] * lateral[k] + glm::dvec3(0.0, 0.0, top[k]));
    return positions_m;
}

/// Returns the low and high corner of the box around all returns of a track, in the frame
/// of the object. Ignores the outermost 1 % of the points at each end, and adds a margin.
std::pair<glm::dvec3, glm::dvec3> bounding_corners(const MoverTrack& track, const GroundPath& poses) {
    std::vector<double> coordinates[3];  // by axis of the object
    for (std::size_t k = 0; k < track.observations.size(); ++k)
        for (const glm::dvec3& p : track.observations[k].cluster.points_m) {
            const glm::dvec3 local = poses[k].to_object(p);
            for (int axis = 0; axis < 3; ++axis) coordinates[axis].push_back(local[axis]);
        }
    glm::dvec3 low, high;
    for (int axis = 0; axis < 3; ++axis) {
        std::vector<double>& sorted = coordinates[axis];
        std::sort(sorted.begin(), sorted.end());
        const std::size_t n_outliers = sorted.size() / 100;
        low[axis] = sorted[n_outliers] - kBoxMargin_m;
        high[axis] = sorted[sorted.size() - 1 - n_outliers] + kBoxMargin_m;
    }
    low.z -= kBoxGround_m;
    return {low, high};
}

/// Typical size of an object of which only one side is visible. Passenger cars are 3.6 to
/// 5 m long and 1.6 to 1.9 m wide. A bicycle is 1.8 m long and its rider 0.6 m wide. The
/// rear of a truck does not show its length. A longer truck would also show its side.
struct TypicalObjectSize {
    const char* name;
    double length_m, width_m;
    double min_length_m, min_width_m;  ///< minimum length and width if all sides of the object are visible
};
constexpr TypicalObjectSize kCar{"car", 4.2, 1.8, 3.4, 1.5}, kCyclistSize{"cyclist", 1.8, 0.6, 1.4, 0.0},
    kTruck{"truck", 7.0, 2.4, 3.4, 1.5};
constexpr double kMinCarSpeed_mps = 2.5;                      // pedestrians side by side look like a slow car
constexpr double kMinTruckHeight_m = 2.5;                     // objects taller than this are trucks
constexpr double kCyclistWidth_m = 1.1, kCyclistTop_m = 1.4;  // maximum width, minimum height of a cyclist

const TypicalObjectSize& guess_object_kind(const glm::dvec3& size_m) {
    if (size_m.x < kCar.min_length_m && size_m.y < kCyclistWidth_m && size_m.z > kCyclistTop_m)
        return kCyclistSize;
    return size_m.z > kMinTruckHeight_m ? kTruck : kCar;
}

/// Returns the side of a box on which the sensor was in more than three quarters of the
/// observations, along one axis of the box: -1 or 1. 0 if there is no such side.
double facing_side(const BoxTrack& box, const MoverTrack& track, int axis) {
    const double min_distance_m = 0.5 * box.size_m[axis] + kMinSideDistance_m;  // from the box centre
    std::size_t n_negative = 0, n_positive = 0;
    for (std::size_t k = 0; k < track.observations.size(); ++k) {
        const glm::dvec3 sensor_in_box = inverse(box.world_from_box.pose[k]) * track.observations[k].sensor_m;
        if (sensor_in_box[axis] < -min_distance_m) ++n_negative;
        if (sensor_in_box[axis] > min_distance_m) ++n_positive;
    }
    const std::size_t three_quarters = track.observations.size() * 3 / 4;
    if (n_negative > three_quarters) return -1.0;
    return n_positive > three_quarters ? 1.0 : 0.0;
}

/// Returns the median pose of a labelled box relative to the position and heading that
/// the visible points give.
/// @param observations indices of the labelled observations to use
/// @param placed [observations of the track] position and heading from the visible points
GroundPose median_offset(const MoverTrack& track, const std::vector<std::size_t>& observations,
                         const GroundPath& placed, const BoxTrack& label) {
    std::vector<double> x, y, z, yaw;
    for (const std::size_t k : observations) {
        const Pose world_from_box = label.world_from_box.pose_at(track.observations[k].cluster.time_s);
        const glm::dvec3 offset_m = placed[k].to_object(world_from_box.translation);
        x.push_back(offset_m.x);
        y.push_back(offset_m.y);
        z.push_back(offset_m.z);
        yaw.push_back(std::remainder(yaw_of(world_from_box) - placed[k].yaw, 2.0 * kPi));
    }
    return {{compute_median(x), compute_median(y), compute_median(z)}, compute_median(yaw)};
}

std::vector<glm::dvec3> cluster_centres_m(const MoverTrack& track) {
    std::vector<glm::dvec3> centres_m;
    for (const MoverObservation& o : track.observations) centres_m.push_back(o.cluster.centre_m);
    return centres_m;
}

}  // namespace

BoxTrack fit_box(const MoverTrack& track) {
    // The first path follows the means of the returns, the next ones estimated centres.
    const std::vector<double> times = track.times_s();
    KinematicPath path = smooth_path(times, cluster_centres_m(track));
    for (int round = 0; round < kPathCorrections; ++round)
        path = smooth_path(times, place_object(track, poses_at_returns(path)));

    const auto [low, high] = bounding_corners(track, poses_at_returns(path));
    BoxTrack box;
    box.category = kDiscoveredCategory;
    box.size_m = high - low;
    const GroundPath at_frames = poses_at_frames(path, track);
    for (std::size_t k = 0; k < at_frames.size(); ++k) {
        box.world_from_box.time_s.push_back(track.observations[k].frame_time_s);
        box.world_from_box.pose.push_back(
            {at_frames[k].orientation(), at_frames[k].to_world(0.5 * (low + high))});
    }
    return box;
}

void enlarge_box(BoxTrack& box, const MoverTrack& track) {
    const std::vector<double> speeds = speeds_mps(box);
    // Slow objects keep their size, because they can be pedestrians.
    if (speeds.empty() || compute_median(speeds) < kMinCarSpeed_mps) return;
    const TypicalObjectSize& kind = guess_object_kind(box.size_m);
    const bool is_short = box.size_m.x < kind.min_length_m, is_narrow = box.size_m.y < kind.min_width_m;
    // An object that is both too short and too narrow is of another kind.
    if (is_short == is_narrow) return;
    glm::dvec3 grown = box.size_m;
    if (is_short) grown.x = kind.length_m;
    if (is_narrow) grown.y = kind.width_m;
    // The visible side stays where it is, so the box grows away from the sensor.
    glm::dvec3 shift(0.0);
    for (int axis = 0; axis < 2; ++axis)
        shift[axis] = -0.5 * facing_side(box, track, axis) * (grown[axis] - box.size_m[axis]);
    box.size_m = grown;
    box.size_guess = kind.name;
    for (Pose& pose : box.world_from_box.pose) pose.translation += pose.rotation * shift;
}

BoxTrack extend_in_time(const MoverTrack& track, const BoxTrack& label) {
    const std::vector<double> times = track.times_s();
    std::vector<std::size_t> labelled;  // indices of the labelled observations
    for (std::size_t k = 0; k < track.observations.size(); ++k)
        if (is_labelled(track.observations[k])) labelled.push_back(k);
    const auto n_per_end = std::ptrdiff_t(std::min(kLabelsPerEnd, labelled.size()));
    const std::vector<std::size_t> first_labels(labelled.begin(), labelled.begin() + n_per_end),
        last_labels(labelled.end() - n_per_end, labelled.end());
    const auto is_before_labels = [&](std::size_t k) { return k < labelled.front(); };
    KinematicPath path = smooth_path(times, cluster_centres_m(track));
    GroundPose before, after;  // offset of the box from the visible points, at the first and last labels
    for (int round = 0; round < kPathCorrections; ++round) {
        // Places the object by its visible points, with the headings of the last path.
        GroundPath placed = poses_at_returns(path);
        std::vector<glm::dvec3> positions_m = place_object(track, placed, glm::dvec2(label.size_m));
        for (std::size_t k = 0; k < placed.size(); ++k) placed[k].position_m = positions_m[k];
        before = median_offset(track, first_labels, placed, label);
        after = median_offset(track, last_labels, placed, label);
        // The path joins the labels and, outside them, the shifted visible points.
        for (std::size_t k = 0; k < positions_m.size(); ++k) {
            const GroundPose& offset = is_before_labels(k) ? before : after;
            positions_m[k] = is_labelled(track.observations[k])
                                 ? label.world_from_box.pose_at(times[k]).translation
                                 : placed[k].to_world(offset.position_m);
        }
        path = smooth_path(times, positions_m);
    }

    const GroundPath at_frames = poses_at_frames(path, track);
    PoseTrack earlier, later;
    for (std::size_t k = 0; k < at_frames.size(); ++k) {
        if (is_labelled(track.observations[k])) continue;
        const bool is_before = is_before_labels(k);
        const double yaw = at_frames[k].yaw + (is_before ? before : after).yaw;
        PoseTrack& side = is_before ? earlier : later;
        side.time_s.push_back(track.observations[k].frame_time_s);
        side.pose.push_back({GroundPose{{}, yaw}.orientation(), at_frames[k].position_m});
    }
    BoxTrack box = label;
    box.n_before = earlier.pose.size();
    box.n_after = later.pose.size();
    PoseTrack& all = box.world_from_box;
    all.time_s.insert(all.time_s.begin(), earlier.time_s.begin(), earlier.time_s.end());
    all.pose.insert(all.pose.begin(), earlier.pose.begin(), earlier.pose.end());
    all.time_s.insert(all.time_s.end(), later.time_s.begin(), later.time_s.end());
    all.pose.insert(all.pose.end(), later.pose.begin(), later.pose.end());
    return box;
}

std::vector<double> speeds_mps(const BoxTrack& box) {
    const PoseTrack& track = box.world_from_box;
    std::vector<double> speeds;
    for (std::size_t start = 0, end = 0; end < track.pose.size(); ++end) {
        // `start` becomes the latest pose at least kSpeedWindow_s older than `end`.
        while (start + 1 < end && track.time_s[end] - track.time_s[start + 1] >= kSpeedWindow_s) ++start;
        const double seconds = track.time_s[end] - track.time_s[start];
        if (seconds >= kSpeedWindow_s)
            speeds.push_back(glm::distance(track.pose[end].translation, track.pose[start].translation) /
                             seconds);
    }
    return speeds;
}

}  // namespace relidar
