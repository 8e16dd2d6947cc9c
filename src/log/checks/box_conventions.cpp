// SPDX-License-Identifier: Apache-2.0
// Compares the points in labelled boxes with the points in boxes that are moved up,
// turned, or mirrored. Points near the ground do not count.
#include "log/checks/checks.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "base/parallel.hpp"

namespace relidar::checks {
namespace {

// A box belongs to the vehicle if it contains a LiDAR in this share of its poses. The
// LiDAR may be above the box by the given height. Buildings are longer.
constexpr double kShareAroundVehicle = 0.9, kAboveVehicle_m = 1.0, kLongestVehicle_m = 30.0;
constexpr std::size_t kMaxFrames = 12, kMaxPoints = 30000;
// The lowest part of a box does not count, because the ground may be there.
constexpr double kGroundHeight_m = 0.3;
// A box is turned only if its shape shows the direction of its length.
constexpr double kMinElongation = 1.3, kShortestCar_m = 2.5;
// The space around an isolated box has fewer points than this share of its points.
constexpr double kShellWidth_m = 0.5, kMaxShellShare = 0.5;
// Maximum number of points of a box in a scan that count, so that near boxes do not
// outvote the others. A convention is better if boxes gain at least kMinPoints points in
// kMinViews scans, and several times the number of points that they lose.
constexpr std::size_t kMaxPerBox = 50, kMinPerBox = 5, kMinPoints = 100, kMinViews = 5;
constexpr double kClearlyMore = 3.0;

/// Possible faults of all boxes of a log.
enum BoxFault : std::size_t {
    kBottomPosition,     ///< positions are the centres of the bottom sides
    kTurned,             ///< yaw angles are wrong by 90 degrees
    kMirroredInWorld,    ///< y coordinates and yaw angles have the opposite sign
    kMirroredInVehicle,  ///< the same in the frame of the vehicle
    kFaultCount
};

/// Points that the boxes gain and lose by a correction, over all scans. A view is a box
/// in a scan that gains at least kMinPerBox points.
struct PointGain {
    std::size_t gained = 0, lost = 0, n_views = 0;

    void add_view(std::size_t n_gained, std::size_t n_lost) {
        gained += std::min(n_gained, kMaxPerBox);
        lost += std::min(n_lost, kMaxPerBox);
        n_views += n_gained >= kMinPerBox;
    }
    bool is_clear() const {
        return gained >= kMinPoints && n_views >= kMinViews && double(gained) > kClearlyMore * double(lost);
    }
};
using PointGains = std::array<PointGain, kFaultCount>;

bool is_elongated(const glm::dvec3& size_m) {
    const auto [shorter, longer] = std::minmax(size_m.x, size_m.y);
    return longer >= kShortestCar_m && longer >= kMinElongation * shorter;
}

bool contains(const glm::dvec3& half_m, const glm::dvec3& local_m, double margin_m = 0.0) {
    return std::abs(local_m.x) <= half_m.x + margin_m && std::abs(local_m.y) <= half_m.y + margin_m &&
           local_m.z >= kGroundHeight_m - half_m.z && local_m.z <= half_m.z;
}

/// Mirrors a pose at the x-z plane of another frame. This negates y, and the parts x and
/// z of the quaternion.
Pose mirror_pose(const Pose& world_from_box, const Pose& world_from_frame) {
    Pose box = inverse(world_from_frame) * world_from_box;
    box.translation.y = -box.translation.y;
    box.rotation = glm::dquat(box.rotation.w, -box.rotation.x, box.rotation.y, -box.rotation.z);
    return world_from_frame * box;
}

/// Returns the pose that a box has at a time if its stored pose has this fault.
Pose correct_box(const Log& log, const BoxTrack& box, double time_s, std::size_t fault) {
    const Pose world_from_box = box.world_from_box.pose_at(time_s);
    if (fault == kBottomPosition) return world_from_box * Pose{{1, 0, 0, 0}, {0.0, 0.0, 0.5 * box.size_m.z}};
    if (fault == kTurned) return world_from_box * Pose{make_rotation(0.5 * kPi, 0.0, 0.0), {}};
    if (fault == kMirroredInVehicle)
        return mirror_pose(world_from_box, log.world_from_vehicle.pose_at(time_s));
    return mirror_pose(world_from_box, {{1, 0, 0, 0}, -log.world_offset_m});
}

/// Points of a scan in the old and the corrected pose of a box.
struct PointCounts {
    std::size_t gained = 0, lost = 0;  ///< only in the corrected box, only in the old box
    std::size_t in_shell = 0;          ///< at most kShellWidth_m outside of the corrected box
};

/// Counts the points that a box gains and loses if its pose is corrected.
/// @param points_m points in the frame of the sensor
/// @param highest_lost_m higher points in the old box do not count as lost
PointCounts count_points(const std::vector<glm::dvec3>& points_m, const Pose& box_from_sensor,
                         const Pose& corrected_from_sensor, const glm::dvec3& half_m, double highest_lost_m) {
    const double max_distance_m = glm::length(half_m) + kShellWidth_m;  // farther points cannot count
    const glm::dvec3 centre_m = inverse(box_from_sensor).translation,
                     corrected_m = inverse(corrected_from_sensor).translation;
    PointCounts counts;
    for (const glm::dvec3& point_m : points_m) {
        if (glm::distance(point_m, centre_m) > max_distance_m &&
            glm::distance(point_m, corrected_m) > max_distance_m)
            continue;
        const glm::dvec3 before_m = box_from_sensor * point_m, after_m = corrected_from_sensor * point_m;
        const bool was_inside = contains(half_m, before_m), is_inside = contains(half_m, after_m);
        if (is_inside && !was_inside) ++counts.gained;
        if (was_inside && !is_inside && before_m.z < highest_lost_m) ++counts.lost;
        if (!is_inside && contains(half_m, after_m, kShellWidth_m)) ++counts.in_shell;
    }
    return counts;
}

/// Returns evenly chosen returns of a scan in the sensor frame, at most about kMaxPoints.
std::vector<glm::dvec3> choose_points_m(const Scan& scan) {
    std::vector<glm::dvec3> points_m;
    const std::size_t step = 1 + scan.count_returns() / kMaxPoints;
    std::size_t n_returns = 0;
    for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray)
        if (scan.range_m[ray] > 0.0f && n_returns++ % step == 0)
            points_m.emplace_back(scan.return_point(ray));
    return points_m;
}

Pose sensor_from_world_at(const Log& log, const Frame& frame, double time_s) {
    return inverse(log.world_from_vehicle.mounted_pose_at(time_s, log.lidar_of(frame).vehicle_from_sensor));
}

/// Returns the time at which the sensor faces a box during the sweep of a frame. This
/// time and the position of the box depend on each other, so it iterates.
double find_facing_time_s(const Log& log, const Frame& frame, const BoxTrack& box) {
    double time_s = frame.time_s;
    for (int round = 0; round < 2; ++round) {
        const glm::dvec3 centre_m = box.world_from_box.pose_at(time_s).translation;
        time_s = facing_time_s(log, sensor_from_world_at(log, frame, time_s) * centre_m, timing_of(frame));
    }
    return time_s;
}

/// Counts the points of a scan that a box gains and loses by the correction of a fault.
/// Points that show nothing about this fault do not count.
PointCounts count_evidence(const Log& log, const BoxTrack& box, double time_s, BoxFault fault,
                           const std::vector<glm::dvec3>& points_m, const Pose& world_from_sensor) {
    // A box whose position is its bottom side has the ground at height 0. To lose points
    // of the ground shows nothing.
    const double highest_lost_m = fault == kBottomPosition ? -0.5 * kGroundHeight_m : INFINITY;
    const Pose world_from_box = box.world_from_box.pose_at(time_s),
               world_from_corrected = correct_box(log, box, time_s, fault);
    PointCounts counts =
        count_points(points_m, inverse(world_from_box) * world_from_sensor,
                     inverse(world_from_corrected) * world_from_sensor, 0.5 * box.size_m, highest_lost_m);
    // A mirrored box moves far, so it can hit a larger object, such as a wall, by chance.
    // The shell then has many points, too.
    const bool can_hit_wall = fault == kMirroredInWorld || fault == kMirroredInVehicle;
    const bool is_isolated = double(counts.in_shell) < kMaxShellShare * double(counts.gained);
    if (can_hit_wall && !is_isolated) counts.gained = 0;
    return counts;
}

/// Adds the points that the boxes of a frame gain and lose by the correction of each
/// fault. The corrections are tried one at a time.
void add_frame_gains(const Log& log, const Frame& frame, PointGains& gains) {
    const std::vector<glm::dvec3> points_m = choose_points_m(frame.scan);
    for (const BoxTrack& box : log.boxes) {
        if (!box.is_observed(frame.time_s)) continue;
        const double time_s = find_facing_time_s(log, frame, box);
        const Pose world_from_sensor = inverse(sensor_from_world_at(log, frame, time_s));
        for (std::size_t fault = 0; fault < kFaultCount; ++fault) {
            // Turning a box shows nothing unless the box is elongated.
            if (fault == kTurned && !is_elongated(box.size_m)) continue;
            const PointCounts counts =
                count_evidence(log, box, time_s, BoxFault(fault), points_m, world_from_sensor);
            gains[fault].add_view(counts.gained, counts.lost);
        }
    }
}

/// Counts for each possible fault the points that the boxes gain and lose if it is
/// corrected. Uses at most kMaxFrames frames, which are spread over the log.
PointGains compare_boxes(const Log& log) {
    std::vector<const Frame*> frames;  // with returns and with boxes
    for (const Frame& frame : log.frames)
        if (frame.scan.count_returns() > 0 && std::ranges::any_of(log.boxes, [&](const BoxTrack& box) {
                return box.is_observed(frame.time_s);
            }))
            frames.push_back(&frame);
    const std::size_t n = std::min(kMaxFrames, frames.size());
    std::vector<PointGains> by_frame(n);
    parallel_for(int(n), [&](int k) {
        add_frame_gains(log, *frames[std::size_t(k) * frames.size() / n], by_frame[std::size_t(k)]);
    });
    PointGains sum{};
    for (const PointGains& gains : by_frame)
        for (std::size_t f = 0; f < sum.size(); ++f) {
            sum[f].gained += gains[f].gained;
            sum[f].lost += gains[f].lost;
            sum[f].n_views += gains[f].n_views;
        }
    return sum;
}

/// True if most elongated boxes are wider than long, as no vehicle is.
bool are_sizes_swapped(const std::vector<BoxTrack>& boxes) {
    int n_wider_minus_longer = 0;
    for (const BoxTrack& box : boxes)
        if (is_elongated(box.size_m)) n_wider_minus_longer += box.size_m.y > box.size_m.x ? 1 : -1;
    return n_wider_minus_longer > 0;
}

/// True if a box contains a LiDAR or the origin of the vehicle.
bool is_around_vehicle(const Log& log, const glm::dvec3& box_size_m, const Pose& world_from_vehicle,
                       const Pose& world_from_box) {
    // A LiDAR on the roof may be above the box. More height below does not matter.
    const glm::dvec3 half_m = 0.5 * box_size_m + glm::dvec3(0, 0, kAboveVehicle_m);
    const auto is_inside = [&](const Pose& vehicle_from_sensor) {
        const glm::dvec3 local_m =
            glm::abs(inverse(world_from_box) * (world_from_vehicle * vehicle_from_sensor.translation));
        return local_m.x <= half_m.x && local_m.y <= half_m.y && local_m.z <= half_m.z;
    };
    const Pose vehicle_origin{};
    return is_inside(vehicle_origin) ||
           std::ranges::any_of(log.lidars, is_inside, &Lidar::vehicle_from_sensor);
}

}  // namespace

void remove_ego_boxes(Log& log) {
    std::vector<std::string> removed_boxes;
    std::erase_if(log.boxes, [&](const BoxTrack& box) {
        const PoseTrack& track = box.world_from_box;
        std::size_t n_around = 0, n_poses = 0;
        for (std::size_t k = 0; k < track.pose.size(); ++k) {
            if (!log.world_from_vehicle.contains_time(track.time_s[k])) continue;
            ++n_poses;
            const Pose world_from_vehicle = log.world_from_vehicle.pose_at(track.time_s[k]);
            if (is_around_vehicle(log, box.size_m, world_from_vehicle, track.pose[k])) ++n_around;
        }
        // Removes a box only if it contains the vehicle at most of the times.
        const bool is_vehicle = n_around > 0 && double(n_around) >= kShareAroundVehicle * double(n_poses) &&
                                std::max(box.size_m.x, box.size_m.y) <= kLongestVehicle_m;
        if (is_vehicle)
            removed_boxes.push_back(
                fmt::format("'{}' ({}, {} of {} poses)", box.id, box.category, n_around, n_poses));
        return is_vehicle;
    });
    if (!removed_boxes.empty())
        log.notes.push_back(
            fmt::format("boxes around the sensor are left out, because they are probably the vehicle: {}",
                        fmt::join(removed_boxes, ", ")));
}

void correct_boxes(Log& log, const Conventions& set) {
    if (log.boxes.empty()) return;
    using Origin = Conventions::BoxOrigin;
    using Axes = Conventions::BoxAxes;
    const auto correct = [&](BoxFault fault) {
        for (BoxTrack& box : log.boxes) {
            const BoxTrack stored = box;
            for (std::size_t k = 0; k < stored.world_from_box.pose.size(); ++k)
                box.world_from_box.pose[k] = correct_box(log, stored, stored.world_from_box.time_s[k], fault);
        }
    };
    if (set.box_origin == Origin::bottom) correct(kBottomPosition);
    if (set.box_axes == Axes::turned) correct(kTurned);
    if (set.box_axes == Axes::mirrored_world) correct(kMirroredInWorld);
    if (set.box_axes == Axes::mirrored_vehicle) correct(kMirroredInVehicle);
    if (set.box_axes == Axes::swapped)
        for (BoxTrack& box : log.boxes) std::swap(box.size_m.x, box.size_m.y);
    constexpr const char* kAxes[] = {"",
                                     "x forward",
                                     "width before length",
                                     "turned by 90 degrees",
                                     "mirrored in the world",
                                     "mirrored in the vehicle"};
    const auto list = [&](const char* name, const char* value, bool is_set, const char* key) {
        log.conventions_used.push_back({name, value, is_set ? kFromSetting : "default", key});
    };
    list("box positions", set.box_origin == Origin::bottom ? "bottom side" : "centre",
         set.box_origin != Origin::automatic, "conventions.box_origin");
    list("box axes", kAxes[std::size_t(std::max(set.box_axes, Axes::right))], set.box_axes != Axes::automatic,
         "conventions.box_axes");
}

std::string describe_fault(const Log& log) {
    const PointGains gains = compare_boxes(log);
    // Points gained minus lost if all boxes had this fault; 0 if too few points show it.
    const auto net_gain = [&](std::size_t fault) {
        return gains[fault].is_clear() ? std::ptrdiff_t(gains[fault].gained - gains[fault].lost) : 0;
    };
    std::size_t best = 0;
    for (std::size_t fault = 1; fault < gains.size(); ++fault)
        if (net_gain(fault) > net_gain(best)) best = fault;
    if (net_gain(best) <= 0) return "";

    constexpr const char* kCorrections[] = {"box_origin=bottom", "box_axes=turned", "box_axes=mirrored_world",
                                            "box_axes=mirrored_vehicle"};
    std::array<const char*, kFaultCount> descriptions;
    descriptions[kBottomPosition] =
        "the positions seem to be the centres of the bottom sides, expected the centres of the boxes";
    const bool is_swapped = best == kTurned && are_sizes_swapped(log.boxes);
    descriptions[kTurned] =
        is_swapped ? "length and width seem to be swapped" : "the yaw seems to be turned by 90 degrees";
    descriptions[kMirroredInWorld] =
        "y and yaw seem to have the opposite sign in the world, as in left-handed coordinates (CARLA)";
    descriptions[kMirroredInVehicle] =
        "y and yaw seem to have the opposite sign in the frame of the vehicle, as in left-handed coordinates "
        "(CARLA)";
    return fmt::format(
        "{}: boxes that are corrected in this way gain {} points and lose {}; "
        "conventions.{} corrects them",
        descriptions[best], gains[best].gained, gains[best].lost,
        is_swapped ? "box_axes=swapped" : kCorrections[best]);
}

}  // namespace relidar::checks
