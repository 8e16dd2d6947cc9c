// SPDX-License-Identifier: Apache-2.0
// Fits a box to each track of a moving object. Uses the end of the object that faces the
// sensor, because only this end is reliably visible.
#include "scene/mover_boxes.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "scene/mover_path.hpp"

namespace relidar {
namespace {

// Number of times that the box is fitted. The first path is curved wrongly where other
// sides of the object become visible. The following fits correct the path.
constexpr int kRounds = 3;
// The top of an object is its highest return within this many seconds before and after.
// The road height changes little in this time.
constexpr double kTop_s = 1.0;
constexpr double kMargin_m = 0.1;  // added around the points of a box
// Boxes are extended downwards by this length, because the lowest part of each box is
// treated as ground (actors.cpp).
constexpr double kGroundOfBox_m = 0.15;
constexpr double kSpeedOver_s = 0.5;
// The offset between a labelled box and the visible points is computed from this many
// labelled observations.
constexpr std::size_t kNearLabels = 10;
// If the sensor is farther outside the box than this, only the near end is visible.
constexpr double kBeside_m = 0.5;

/// Position and heading of an object on the ground. They define the frame of the object.
struct Placement {
    glm::dvec3 position_m{0.0};
    double yaw = 0.0;
    glm::dvec3 get_forward_axis() const { return {std::cos(yaw), std::sin(yaw), 0.0}; }
    glm::dvec3 get_lateral_axis() const { return {-std::sin(yaw), std::cos(yaw), 0.0}; }
    glm::dquat rotation() const { return {std::cos(0.5 * yaw), 0.0, 0.0, std::sin(0.5 * yaw)}; }
    /// Transforms a point from the world frame into the frame of the object: x along the
    /// heading, y to the left.
    glm::dvec3 to_local(const glm::dvec3& world) const {
        const glm::dvec3 d = world - position_m;
        return {glm::dot(get_forward_axis(), d), glm::dot(get_lateral_axis(), d), d.z};
    }
    glm::dvec3 to_world(const glm::dvec3& local) const {
        return position_m + local.x * get_forward_axis() + local.y * get_lateral_axis() +
               glm::dvec3(0.0, 0.0, local.z);
    }
};

double get_yaw(const Pose& pose) {
    const glm::dvec3 forward = pose.rotation * glm::dvec3(1.0, 0.0, 0.0);
    return std::atan2(forward.y, forward.x);
}

std::vector<glm::dvec3> list_positions(const std::vector<PathState>& path) {
    std::vector<glm::dvec3> positions;
    for (const PathState& state : path) positions.push_back(state.position_m);
    return positions;
}

std::vector<Placement> find_placements_along(const std::vector<glm::dvec3>& path) {
    const std::vector<double> yaw = compute_headings_along(path);
    std::vector<Placement> placed;
    for (std::size_t k = 0; k < path.size(); ++k) placed.push_back({path[k], yaw[k]});
    return placed;
}

/// Returns the position and heading of the object at the reference time of each frame.
std::vector<Placement> find_placements_at_frames(const MoverTrack& track,
                                                 const std::vector<PathState>& path) {
    std::vector<glm::dvec3> positions;
    for (std::size_t k = 0; k < path.size(); ++k)
        positions.push_back(path[k].after(track.seen[k].frame_time_s - track.seen[k].cluster.time_s));
    return find_placements_along(positions);
}

/// Interval that the points of an observation cover along an axis. Ignores the outermost
/// 0.5 % of the points at each end.
struct Extent {
    double low, high;
};
Extent compute_extent_along(const MoverCluster& cluster, const glm::dvec3& axis) {
    std::vector<double> values;
    for (const glm::dvec3& p : cluster.points_m) values.push_back(glm::dot(axis, p));
    std::sort(values.begin(), values.end());
    const std::size_t cut = values.size() / 200;
    return {values[cut], values[values.size() - 1 - cut]};
}

/// Returns half the visible length of an object. Measures the length along the axis of
/// each observation, and uses the 90th percentile.
double estimate_visible_half_length_m(const MoverTrack& track, const std::vector<glm::dvec3>& axes) {
    std::vector<double> lengths;
    for (std::size_t k = 0; k < axes.size(); ++k) {
        const auto [low, high] = compute_extent_along(track.seen[k].cluster, axes[k]);
        lengths.push_back(high - low);
    }
    std::sort(lengths.begin(), lengths.end());
    return 0.5 * lengths[lengths.size() * 9 / 10];
}

/// Returns the centre of an object along an axis, for each observation. The centre is
/// half the size of the object behind its visible end, which faces the sensor.
std::vector<double> compute_centres_along(const MoverTrack& track, const std::vector<glm::dvec3>& axes,
                                          double half) {
    std::vector<double> centres;
    for (std::size_t k = 0; k < axes.size(); ++k) {
        const auto [low, high] = compute_extent_along(track.seen[k].cluster, axes[k]);
        const double sensor = glm::dot(axes[k], track.seen[k].sensor_m);
        centres.push_back(sensor > high ? high - half : sensor < low ? low + half : 0.5 * (low + high));
    }
    return centres;
}

/// Returns the height of the object's top for each observation. Uses the highest return
/// within one second before and after, because beams can miss the top of a distant
/// object.
std::vector<double> compute_top_heights(const MoverTrack& track) {
    std::vector<double> own, result;
    for (const Observation& o : track.seen)
        own.push_back(compute_extent_along(o.cluster, {0.0, 0.0, 1.0}).high);
    for (const Observation& o : track.seen) {
        double top = -1e30;
        for (std::size_t j = 0; j < own.size(); ++j)
            if (std::abs(track.seen[j].cluster.time_s - o.cluster.time_s) < kTop_s)
                top = std::max(top, own[j]);
        result.push_back(top);
    }
    return result;
}

/// Returns the position of the object in each observation. Computes the horizontal centre
/// from the end that faces the sensor. The height is the top of the object.
/// @param size_m length and width; if null, the visible size is used
std::vector<glm::dvec3> estimate_positions_from_near_end(const MoverTrack& track,
                                                         const std::vector<Placement>& placed,
                                                         const glm::dvec3* size_m) {
    std::vector<glm::dvec3> along, across, places;
    for (const Placement& p : placed)
        along.push_back(p.get_forward_axis()), across.push_back(p.get_lateral_axis());
    const std::vector<double> x = compute_centres_along(
        track, along, size_m ? 0.5 * size_m->x : estimate_visible_half_length_m(track, along));
    const std::vector<double> y = compute_centres_along(
        track, across, size_m ? 0.5 * size_m->y : estimate_visible_half_length_m(track, across));
    const std::vector<double> top = compute_top_heights(track);
    for (std::size_t k = 0; k < placed.size(); ++k)
        places.push_back(x[k] * along[k] + y[k] * across[k] + glm::dvec3(0.0, 0.0, top[k]));
    return places;
}

/// Corners of the box around all returns of a track, in the frame of the object. Ignores
/// the outermost 1 % of the points at each end, and adds a margin.
struct Corners {
    glm::dvec3 low, high;
};
Corners find_nearest_corners(const MoverTrack& track, const std::vector<Placement>& placed) {
    std::vector<double> along[3];
    for (std::size_t k = 0; k < track.seen.size(); ++k)
        for (const glm::dvec3& p : track.seen[k].cluster.points_m) {
            const glm::dvec3 local = placed[k].to_local(p);
            for (int axis = 0; axis < 3; ++axis) along[axis].push_back(local[axis]);
        }
    Corners corners;
    for (int axis = 0; axis < 3; ++axis) {
        std::sort(along[axis].begin(), along[axis].end());
        const std::size_t cut = along[axis].size() / 100;
        corners.low[axis] = along[axis][cut] - kMargin_m;
        corners.high[axis] = along[axis][along[axis].size() - 1 - cut] + kMargin_m;
    }
    corners.low.z -= kGroundOfBox_m;
    return corners;
}

/// Typical size of an object of which only one side is visible. Passenger cars are 3.6 to
/// 5 m long and 1.6 to 1.9 m wide. A bicycle is 1.8 m long and its rider 0.6 m wide. The
/// length of a truck or a bus cannot be estimated from its rear. The length of a light
/// truck is used instead, because a longer truck would also show its side.
struct Kind {
    const char* name;
    double length_m, width_m;
    /// minimum length and width of an object whose sides are all visible; a smaller box
    /// shows only one side
    double least_length_m, least_width_m;
};
constexpr Kind kCar{"car", 4.2, 1.8, 3.4, 1.5}, kCyclist{"cyclist", 1.8, 0.6, 1.4, 0.0},
    kTruck{"truck", 7.0, 2.4, 3.4, 1.5};
// Minimum speed of a vehicle in m/s. Slower objects can be pedestrians, who look like a
// car if they walk side by side.
constexpr double kDrives_mps = 2.5;
constexpr double kTruck_m = 2.5;  // objects taller than this are trucks
// An object that is narrower than the first value and taller than the second is a
// cyclist.
constexpr double kCyclistWidth_m = 1.1, kCyclistTop_m = 1.4;

/// Returns the kind of an object of which only the rear, the front or a side is visible.
/// Returns null if the object is too slow or too small to classify.
const Kind* classify_size(const glm::dvec3& size_m, double speed_mps) {
    if (speed_mps < kDrives_mps) return nullptr;
    const bool cyclist =
        size_m.y < kCyclistWidth_m && size_m.z > kCyclistTop_m && size_m.x < kCar.least_length_m;
    const Kind* kind = cyclist ? &kCyclist : size_m.z > kTruck_m ? &kTruck : &kCar;
    return size_m.x < kind->least_length_m && size_m.y < kind->least_width_m ? nullptr : kind;
}

/// Returns on which side of a box the sensor was most of the time, along one axis. The
/// result is -1 or 1. Returns 0 if the sensor was next to the box or on both sides.
double find_side_of_sensor(const BoxTrack& box, const MoverTrack& track, int axis) {
    std::ptrdiff_t low = 0, high = 0;
    for (std::size_t k = 0; k < track.seen.size(); ++k) {
        const double at = (inverse(box.world_from_box.pose[k]) * track.seen[k].sensor_m)[axis];
        low += at<-0.5 * box.size_m[axis] - kBeside_m, high += at> 0.5 * box.size_m[axis] + kBeside_m;
    }
    const auto most = std::ptrdiff_t(track.seen.size() * 3 / 4);
    return low > most ? -1.0 : high > most ? 1.0 : 0.0;
}

bool is_labelled(const Observation& observation) { return observation.cluster.label != kNoLabel; }

double median(std::vector<double> values) {
    std::nth_element(values.begin(), values.begin() + std::ptrdiff_t(values.size() / 2), values.end());
    return values[values.size() / 2];
}

/// Offset of a labelled box from the visible points of its object. Holds a translation in
/// the frame of the object and a rotation about z.
struct Offset {
    glm::dvec3 local_m{0.0};
    double yaw = 0.0;
};
/// Returns the median offset between a labelled box and the visible points of its object.
/// @param members indices of the labelled observations to use
Offset estimate_offset(const MoverTrack& track, const std::vector<std::size_t>& members,
                       const std::vector<Placement>& placed, const std::vector<glm::dvec3>& places,
                       const BoxTrack& label) {
    std::vector<double> values[4];
    for (const std::size_t k : members) {
        const Pose pose = label.world_from_box.at(track.seen[k].cluster.time_s);
        const glm::dvec3 local = Placement{places[k], placed[k].yaw}.to_local(pose.translation);
        for (int axis = 0; axis < 3; ++axis) values[axis].push_back(local[axis]);
        values[3].push_back(std::remainder(get_yaw(pose) - placed[k].yaw, 2.0 * kPi));
    }
    return {{median(values[0]), median(values[1]), median(values[2])}, median(values[3])};
}

/// Indices of the first few and of the last few labelled observations of a track.
struct NearLabels {
    std::vector<std::size_t> first, last;
};
NearLabels collect_near_labels(const MoverTrack& track) {
    std::vector<std::size_t> all;
    for (std::size_t k = 0; k < track.seen.size(); ++k)
        if (is_labelled(track.seen[k])) all.push_back(k);
    const auto n = std::ptrdiff_t(std::min(kNearLabels, all.size()));
    return {{all.begin(), all.begin() + n}, {all.end() - n, all.end()}};
}

}  // namespace

BoxTrack fit_track_box(const MoverTrack& track) {
    const std::vector<double> times = track.times();
    std::vector<glm::dvec3> places;
    for (const Observation& o : track.seen) places.push_back(o.cluster.centre_m);
    std::vector<PathState> path = smooth_path(times, places);
    for (int round = 0; round < kRounds; ++round)
        path = smooth_path(times, estimate_positions_from_near_end(
                                      track, find_placements_along(list_positions(path)), nullptr));
    const auto [low, high] = find_nearest_corners(track, find_placements_along(list_positions(path)));
    const std::vector<Placement> at_frames = find_placements_at_frames(track, path);
    BoxTrack box;
    box.category = kDiscoveredCategory;
    box.size_m = high - low;
    for (std::size_t k = 0; k < at_frames.size(); ++k) {
        box.world_from_box.time_s.push_back(track.seen[k].frame_time_s);
        box.world_from_box.pose.push_back(
            {at_frames[k].rotation(), at_frames[k].to_world(0.5 * (low + high))});
    }
    return box;
}

void complete_size(BoxTrack& box, const MoverTrack& track) {
    const std::vector<double> speeds = compute_speeds_mps(box);
    const Kind* kind = speeds.empty() ? nullptr : classify_size(box.size_m, median(speeds));
    if (!kind) return;
    glm::dvec3 grown = box.size_m, shift(0.0);
    if (box.size_m.x < kind->least_length_m) grown.x = kind->length_m;
    if (box.size_m.y < kind->least_width_m) grown.y = kind->width_m;
    if (grown == box.size_m) return;
    for (int axis = 0; axis < 2; ++axis)
        shift[axis] = -0.5 * find_side_of_sensor(box, track, axis) * (grown[axis] - box.size_m[axis]);
    box.size_m = grown;
    box.size_guess = kind->name;
    for (Pose& pose : box.world_from_box.pose) pose.translation += pose.rotation * shift;
}

BoxTrack make_continued_box(const MoverTrack& track, const BoxTrack& label) {
    const std::vector<double> times = track.times();
    const NearLabels near = collect_near_labels(track);
    const auto is_before = [&](std::size_t index) { return index < near.first.front(); };
    std::vector<glm::dvec3> places;
    for (const Observation& o : track.seen) places.push_back(o.cluster.centre_m);
    std::vector<PathState> path = smooth_path(times, places);
    Offset before, after;
    for (int round = 0; round < kRounds; ++round) {
        const std::vector<Placement> placed = find_placements_along(list_positions(path));
        places = estimate_positions_from_near_end(track, placed, &label.size_m);
        before = estimate_offset(track, near.first, placed, places, label),
        after = estimate_offset(track, near.last, placed, places, label);
        for (std::size_t k = 0; k < places.size(); ++k)
            places[k] =
                is_labelled(track.seen[k])
                    ? label.world_from_box.at(times[k]).translation
                    : Placement{places[k], placed[k].yaw}.to_world((is_before(k) ? before : after).local_m);
        path = smooth_path(times, places);
    }
    const std::vector<Placement> at_frames = find_placements_at_frames(track, path);
    BoxTrack box = label;
    PoseTrack poses[2];  // [0] poses before the labels, [1] poses after the labels
    for (std::size_t k = 0; k < at_frames.size(); ++k) {
        if (is_labelled(track.seen[k])) continue;
        PoseTrack& side = poses[is_before(k) ? 0 : 1];
        side.time_s.push_back(track.seen[k].frame_time_s);
        side.pose.push_back({Placement{{}, at_frames[k].yaw + (is_before(k) ? before : after).yaw}.rotation(),
                             at_frames[k].position_m});
    }
    box.n_before = poses[0].pose.size(), box.n_after = poses[1].pose.size();
    PoseTrack& all = box.world_from_box;
    all.time_s.insert(all.time_s.begin(), poses[0].time_s.begin(), poses[0].time_s.end());
    all.pose.insert(all.pose.begin(), poses[0].pose.begin(), poses[0].pose.end());
    all.time_s.insert(all.time_s.end(), poses[1].time_s.begin(), poses[1].time_s.end());
    all.pose.insert(all.pose.end(), poses[1].pose.begin(), poses[1].pose.end());
    return box;
}

std::vector<double> compute_speeds_mps(const BoxTrack& box) {
    const PoseTrack& track = box.world_from_box;
    std::vector<double> speeds;
    for (std::size_t i = 0, j = 0; j < track.pose.size(); ++j) {
        while (track.time_s[j] - track.time_s[i + 1 < j ? i + 1 : i] >= kSpeedOver_s) ++i;
        const double seconds = track.time_s[j] - track.time_s[i];
        if (seconds >= kSpeedOver_s)
            speeds.push_back(glm::distance(track.pose[j].translation, track.pose[i].translation) / seconds);
    }
    return speeds;
}

}  // namespace relidar
