// SPDX-License-Identifier: Apache-2.0
// Fits a box to each track of a moving object. Uses the end of the object that faces the
// sensor, because it is the only end that the sensor reliably sees.

#include <cmath>

#include "scene/movers/mover_tracks.hpp"

namespace relidar {
namespace {

// Number of corrections of a path. The centre of the visible points, which the first path
// follows, shifts when other sides of the object become visible.
constexpr int kPathCorrections = 3;
// The top of an object is its highest return within this time before and after a frame.
constexpr double kTopWindow_s = 1.0;
constexpr double kBoxMargin_m = 0.1;  // added around the points of a box
// Boxes are extended downwards, because actors.cpp treats their lowest part as ground.
constexpr double kBoxGround_m = 0.15;
constexpr double kSpeedWindow_s = 0.5;
// Number of labels from which the offset between box and visible points is computed.
constexpr std::size_t kLabelsPerEnd = 10;
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
using GroundPath = std::vector<GroundPose>;

double yaw_of(const Pose& pose) {
    const glm::dvec3 forward = pose.rotation * glm::dvec3(1.0, 0.0, 0.0);
    return std::atan2(forward.y, forward.x);
}

/// Returns the positions on a path with their headings: at the times of the observations,
/// or at the reference times of their frames.
GroundPath compute_ground_poses(const KinematicPath& path, const MoverTrack& track, bool at_frames = false) {
    std::vector<glm::dvec3> positions;
    for (std::size_t k = 0; k < path.size(); ++k)
        positions.push_back(at_frames ? path[k].position_after(track.observations[k].frame_time_s -
                                                               track.observations[k].cluster.time_s)
                                      : path[k].position_m);
    const std::vector<double> yaw = path_headings_rad(positions);
    GroundPath placed;
    for (std::size_t k = 0; k < path.size(); ++k) placed.push_back({positions[k], yaw[k]});
    return placed;
}

/// Returns the interval that the points of an observation cover along an axis, without
/// the outermost 0.5 % of the points at each end.
std::pair<double, double> extent_along(const MoverCluster& cluster, const glm::dvec3& axis) {
    std::vector<double> values;
    for (const glm::dvec3& p : cluster.points_m) values.push_back(glm::dot(axis, p));
    std::sort(values.begin(), values.end());
    const std::size_t cut = values.size() / 200;
    return {values[cut], values[values.size() - 1 - cut]};
}

/// Returns the position of an object's centre along an axis, for each observation. The
/// visible end faces the sensor. The centre is half the object's size behind this end.
/// @param size_m size along the axis; if empty, the 90th percentile of the visible sizes
std::vector<double> centres_along(const MoverTrack& track, const std::vector<glm::dvec3>& axes,
                                  std::optional<double> size_m) {
    std::vector<std::pair<double, double>> extents;
    std::vector<double> lengths, centres;
    for (std::size_t k = 0; k < axes.size(); ++k) {
        extents.push_back(extent_along(track.observations[k].cluster, axes[k]));
        lengths.push_back(extents[k].second - extents[k].first);
    }
    std::sort(lengths.begin(), lengths.end());
    const double half_size_m = 0.5 * size_m.value_or(lengths[lengths.size() * 9 / 10]);
    for (std::size_t k = 0; k < axes.size(); ++k) {
        const auto [low, high] = extents[k];
        const double sensor = glm::dot(axes[k], track.observations[k].sensor_m);
        double centre = 0.5 * (low + high);
        // The near end is reliable. If the sensor is beside the object, both ends are
        // visible.
        if (sensor > high) centre = high - half_size_m;
        else if (sensor < low) centre = low + half_size_m;
        centres.push_back(centre);
    }
    return centres;
}

/// Returns the height of the object's top for each observation. Beams can miss the top of
/// a distant object, so neighbouring observations count too.
std::vector<double> top_heights_m(const MoverTrack& track) {
    std::vector<double> tops_m, result;
    for (const MoverObservation& o : track.observations)
        tops_m.push_back(extent_along(o.cluster, {0.0, 0.0, 1.0}).second);
    for (const MoverObservation& o : track.observations) {
        double top = -1e30;
        for (std::size_t j = 0; j < tops_m.size(); ++j)
            if (std::abs(track.observations[j].cluster.time_s - o.cluster.time_s) < kTopWindow_s)
                top = std::max(top, tops_m[j]);
        result.push_back(top);
    }
    return result;
}

/// Returns the position of the object in each observation: its centre in x and y, and its
/// top in z.
/// @param size_m length and width; if empty, the visible size is used
std::vector<glm::dvec3> place_object(const MoverTrack& track, const GroundPath& poses,
                                     std::optional<glm::dvec2> size_m = {}) {
    std::vector<glm::dvec3> along, across, positions_m;
    for (const GroundPose& p : poses) {
        along.push_back(p.forward_axis());
        across.push_back(p.lateral_axis());
    }
    const auto size_of = [&](int axis) { return size_m ? std::optional((*size_m)[axis]) : std::nullopt; };
    const std::vector<double> x = centres_along(track, along, size_of(0)),
                              y = centres_along(track, across, size_of(1));
    const std::vector<double> top = top_heights_m(track);
    for (std::size_t k = 0; k < poses.size(); ++k)
        positions_m.push_back(x[k] * along[k] + y[k] * across[k] + glm::dvec3(0.0, 0.0, top[k]));
    return positions_m;
}

/// Returns the low and high corner of the box around all returns of a track, in the frame
/// of the object. Ignores the outermost 1 % of the points at each end, and adds a margin.
std::pair<glm::dvec3, glm::dvec3> bounding_corners(const MoverTrack& track, const GroundPath& poses) {
    std::vector<double> along[3];
    for (std::size_t k = 0; k < track.observations.size(); ++k)
        for (const glm::dvec3& p : track.observations[k].cluster.points_m) {
            const glm::dvec3 local = poses[k].to_object(p);
            for (int axis = 0; axis < 3; ++axis) along[axis].push_back(local[axis]);
        }
    glm::dvec3 low, high;
    for (int axis = 0; axis < 3; ++axis) {
        std::sort(along[axis].begin(), along[axis].end());
        const std::size_t cut = along[axis].size() / 100;
        low[axis] = along[axis][cut] - kBoxMargin_m;
        high[axis] = along[axis][along[axis].size() - 1 - cut] + kBoxMargin_m;
    }
    low.z -= kBoxGround_m;
    return {low, high};
}

/// Typical size of an object of which only one side is visible. Passenger cars are 3.6 to
/// 5 m long and 1.6 to 1.9 m wide. A bicycle is 1.8 m long and its rider 0.6 m wide. The
/// length of a truck or a bus cannot be estimated from its rear. A longer truck would
/// also show its side.
struct TypicalObjectSize {
    const char* name;
    double length_m, width_m;
    /// Minimum length and width if all sides of the object are visible.
    double least_length_m, least_width_m;
};
constexpr TypicalObjectSize kCar{"car", 4.2, 1.8, 3.4, 1.5}, kCyclist{"cyclist", 1.8, 0.6, 1.4, 0.0},
    kTruck{"truck", 7.0, 2.4, 3.4, 1.5};
// Slower objects can be pedestrians, who look like a car if they walk side by side.
constexpr double kMinCarSpeed_mps = 2.5;
constexpr double kMinTruckHeight_m = 2.5;  // objects taller than this are trucks
// Maximum width and minimum height of an object that counts as a cyclist.
constexpr double kCyclistWidth_m = 1.1, kCyclistTop_m = 1.4;

/// Returns the side of a box on which the sensor was in more than three quarters of the
/// observations, along one axis: -1 or 1. Returns 0 if no side has so many observations.
double facing_side(const BoxTrack& box, const MoverTrack& track, int axis) {
    std::ptrdiff_t low = 0, high = 0;
    for (std::size_t k = 0; k < track.observations.size(); ++k) {
        const double at = (inverse(box.world_from_box.pose[k]) * track.observations[k].sensor_m)[axis];
        low += at<-0.5 * box.size_m[axis] - kMinSideDistance_m, high += at> 0.5 * box.size_m[axis] +
               kMinSideDistance_m;
    }
    const auto most = std::ptrdiff_t(track.observations.size() * 3 / 4);
    if (low > most) return -1.0;
    return high > most ? 1.0 : 0.0;
}

/// Returns the median pose of a labelled box in the frame of the visible points.
/// @param indices indices of the labelled observations to use
GroundPose median_offset(const MoverTrack& track, const std::vector<std::size_t>& indices,
                         const GroundPath& poses, const std::vector<glm::dvec3>& positions_m,
                         const BoxTrack& label) {
    std::vector<double> values[4];
    for (const std::size_t k : indices) {
        const Pose pose = label.world_from_box.pose_at(track.observations[k].cluster.time_s);
        const glm::dvec3 local = GroundPose{positions_m[k], poses[k].yaw}.to_object(pose.translation);
        for (int axis = 0; axis < 3; ++axis) values[axis].push_back(local[axis]);
        values[3].push_back(std::remainder(yaw_of(pose) - poses[k].yaw, 2.0 * kPi));
    }
    return {{compute_median(values[0]), compute_median(values[1]), compute_median(values[2])},
            compute_median(values[3])};
}

}  // namespace

BoxTrack fit_box(const MoverTrack& track) {
    const std::vector<double> times = track.times_s();
    std::vector<glm::dvec3> positions_m;
    for (const MoverObservation& o : track.observations) positions_m.push_back(o.cluster.centre_m);
    KinematicPath path = smooth_path(times, positions_m);
    // Each round replaces the means of the returns by estimated object positions.
    for (int round = 0; round < kPathCorrections; ++round)
        path = smooth_path(times, place_object(track, compute_ground_poses(path, track)));
    const auto [low, high] = bounding_corners(track, compute_ground_poses(path, track));
    // true: at the reference times of the frames, not at the times of the returns
    const GroundPath at_frames = compute_ground_poses(path, track, true);
    BoxTrack box;
    box.category = kDiscoveredCategory;
    box.size_m = high - low;
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
    const bool cyclist =
        box.size_m.y < kCyclistWidth_m && box.size_m.z > kCyclistTop_m && box.size_m.x < kCar.least_length_m;
    const TypicalObjectSize* kind = box.size_m.z > kMinTruckHeight_m ? &kTruck : &kCar;
    if (cyclist) kind = &kCyclist;
    // An object keeps its size if it is both too short and too narrow for its `kind`.
    if (box.size_m.x < kind->least_length_m && box.size_m.y < kind->least_width_m) return;
    glm::dvec3 grown = box.size_m, shift(0.0);
    if (box.size_m.x < kind->least_length_m) grown.x = kind->length_m;
    if (box.size_m.y < kind->least_width_m) grown.y = kind->width_m;
    if (grown == box.size_m) return;
    for (int axis = 0; axis < 2; ++axis)
        // The visible side stays where it was measured, so the box grows away from the
        // sensor.
        shift[axis] = -0.5 * facing_side(box, track, axis) * (grown[axis] - box.size_m[axis]);
    box.size_m = grown;
    box.size_guess = kind->name;
    for (Pose& pose : box.world_from_box.pose) pose.translation += pose.rotation * shift;
}

BoxTrack extend_in_time(const MoverTrack& track, const BoxTrack& label) {
    const std::vector<double> times = track.times_s();
    std::vector<std::size_t> labels;  // indices of the labelled observations
    for (std::size_t k = 0; k < track.observations.size(); ++k)
        if (is_labelled(track.observations[k])) labels.push_back(k);
    const auto n_per_end = std::ptrdiff_t(std::min(kLabelsPerEnd, labels.size()));
    const std::vector<std::size_t> first_labels(labels.begin(), labels.begin() + n_per_end),
        last_labels(labels.end() - n_per_end, labels.end());
    const auto is_before = [&](std::size_t index) { return index < first_labels.front(); };
    std::vector<glm::dvec3> positions_m;
    for (const MoverObservation& o : track.observations) positions_m.push_back(o.cluster.centre_m);
    KinematicPath path = smooth_path(times, positions_m);
    GroundPose before, after;
    for (int round = 0; round < kPathCorrections; ++round) {
        const GroundPath ground_poses = compute_ground_poses(path, track);
        positions_m = place_object(track, ground_poses, glm::dvec2(label.size_m));
        // The labels at both ends define how the box lies relative to the visible points.
        before = median_offset(track, first_labels, ground_poses, positions_m, label);
        after = median_offset(track, last_labels, ground_poses, positions_m, label);
        for (std::size_t k = 0; k < positions_m.size(); ++k)
            positions_m[k] = is_labelled(track.observations[k])
                                 ? label.world_from_box.pose_at(times[k]).translation
                                 : GroundPose{positions_m[k], ground_poses[k].yaw}.to_world(
                                       (is_before(k) ? before : after).position_m);
        path = smooth_path(times, positions_m);
    }
    const GroundPath at_frames = compute_ground_poses(path, track, true);
    BoxTrack box = label;
    PoseTrack poses[2];  // [0] poses before the labels, [1] poses after the labels
    for (std::size_t k = 0; k < at_frames.size(); ++k) {
        if (is_labelled(track.observations[k])) continue;
        PoseTrack& side = poses[is_before(k) ? 0 : 1];
        side.time_s.push_back(track.observations[k].frame_time_s);
        side.pose.push_back(
            {GroundPose{{}, at_frames[k].yaw + (is_before(k) ? before : after).yaw}.orientation(),
             at_frames[k].position_m});
    }
    box.n_before = poses[0].pose.size();
    box.n_after = poses[1].pose.size();
    PoseTrack& all = box.world_from_box;
    all.time_s.insert(all.time_s.begin(), poses[0].time_s.begin(), poses[0].time_s.end());
    all.pose.insert(all.pose.begin(), poses[0].pose.begin(), poses[0].pose.end());
    all.time_s.insert(all.time_s.end(), poses[1].time_s.begin(), poses[1].time_s.end());
    all.pose.insert(all.pose.end(), poses[1].pose.begin(), poses[1].pose.end());
    return box;
}

std::vector<double> speeds_mps(const BoxTrack& box) {
    const PoseTrack& track = box.world_from_box;
    std::vector<double> speeds;
    for (std::size_t i = 0, j = 0; j < track.pose.size(); ++j) {
        // i becomes the latest pose before j that is at least kSpeedWindow_s older.
        while (i + 1 < j && track.time_s[j] - track.time_s[i + 1] >= kSpeedWindow_s) ++i;
        const double seconds = track.time_s[j] - track.time_s[i];
        if (seconds >= kSpeedWindow_s)
            speeds.push_back(glm::distance(track.pose[j].translation, track.pose[i].translation) / seconds);
    }
    return speeds;
}

}  // namespace relidar
