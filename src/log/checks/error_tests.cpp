// SPDX-License-Identifier: Apache-2.0
// Tests for faults that make a log unusable.
#include <cmath>
#include <set>
#include <utility>

#include "base/parallel.hpp"
#include "log/checks/checks.hpp"

namespace relidar::checks {
namespace {

// Maximum difference between 1 and the length of a direction or quaternion.
constexpr double kMaxLengthError = 1e-3;
// Minimum time between poses. With less time, velocities would be mostly noise.
constexpr double kMinStep_s = 1e-3;
constexpr double kMaxOffset_s = 10.0;  // between the firing of a ray and its frame
// Limit of ranges, and of distances from the origin of the world.
constexpr double kMaxDistance_m = 1e6;
// Boxes that are in map coordinates by mistake are usually farther from the vehicle.
constexpr double kMaxBoxDistance_m = 1e5;
constexpr double kMaxOrigin_m = 1000.0;  // distance between the origin of a ray and the sensor
constexpr double kMaxDivergence_rad = 6.3;

}  // namespace

void test_frames(const CheckedLog& log, const FaultReport& report) {
    if (log.sequence.frames.empty()) report.add(-1);
}

void test_lidar_names(const CheckedLog& log, const FaultReport& report) {
    std::set<std::string> names;
    for (const Lidar& lidar : log.sequence.lidars)
        if (!names.insert(lidar.name).second) report.add(-1, lidar.name);
}

void test_frame_numbers(const CheckedLog& log, const FaultReport& report) {
    std::set<std::pair<int, int>> numbers;
    for (const Frame& frame : log.sequence.frames)
        if (!numbers.insert({frame.lidar, frame.index}).second) report.add(-1, frame.index);
}

void test_frame_times(const CheckedLog& log, const FaultReport& report) {
    for (std::size_t i = 1; i < log.sequence.frames.size(); ++i) {
        const Frame &before = log.sequence.frames[i - 1], &frame = log.sequence.frames[i];
        const double step_s = frame.time_s - before.time_s;
        if (!(step_s >= kMinStep_s) && !(step_s == 0.0 && frame.lidar > before.lidar))
            report.add(-1, frame.index, frame.time_s, before.index, before.time_s, kMinStep_s);
    }
}

/// Tests all poses: the LiDAR mountings, the vehicle and the boxes.
void test_poses(const CheckedLog& log, const FaultReport& report) {
    const auto test_pose = [&](const std::string& name, const Pose& pose) {
        const auto& [q, t] = pose;
        // NaN fails this comparison. -1: a fault of the log, not of one LiDAR.
        if (!(glm::length(t) <= kMaxDistance_m && std::abs(glm::length(q) - 1.0) <= kMaxLengthError))
            report.add(-1, name, t.x, t.y, t.z, glm::length(q), kMaxDistance_m);
    };
    const auto test_track = [&](const std::string& name, const PoseTrack& track) {
        for (std::size_t k = 0; k < track.pose.size(); ++k)
            test_pose(fmt::format("{}, pose {}", name, k), track.pose[k]);
    };
    for (const Lidar& lidar : log.sequence.lidars)
        test_pose(fmt::format("LiDAR '{}', vehicle_from_sensor", lidar.name), lidar.vehicle_from_sensor);
    test_track("the vehicle", log.sequence.world_from_vehicle);
    for (const BoxTrack& box : log.sequence.boxes)
        test_track(fmt::format("box '{}'", box.id), box.world_from_box);
}

void test_array_sizes(const CheckedLog& log, const FaultReport& report) {
    for (const Frame& frame : log.sequence.frames) {
        const Scan& scan = frame.scan;
        const RayTable& rays = scan.rays;
        const auto test_size = [&](const char* field, std::size_t size) {
            if (size != std::size_t(rays.rows) * std::size_t(rays.columns))
                // -1: a fault of the log, not of one LiDAR.
                report.add(-1, frame.index, field, size, rays.rows, rays.columns);
        };
        test_size("rays.origin", rays.origin.size());
        test_size("rays.direction", rays.direction.size());
        test_size("rays.time_offset_s", rays.time_offset_s.size());
        test_size("rays.channel", rays.channel.size());
        if (const auto& angles = rays.ray_divergence_rad; !angles.empty())
            test_size("rays.ray_divergence_rad", angles.size());
        test_size("range_m", scan.range_m.size());
        test_size("intensity", scan.intensity.size());
        if (!scan.classes.empty()) test_size("classes", scan.classes.size());
        for (const AdditionalReturns& second : scan.second_returns) {
            test_size("second_returns.range_m", second.range_m.size());
            test_size("second_returns.intensity", second.intensity.size());
        }
    }
}

/// Tests each value of each ray against its limits. NaN is outside all limits.
void test_rays(const CheckedLog& log, const FaultReport& report) {
    parallel_for(int(log.sequence.frames.size()), [&](int index) {
        const Frame& frame = log.sequence.frames[std::size_t(index)];
        const Scan& scan = frame.scan;
        const std::size_t n_beams = log.sequence.lidar_of(frame).sensor.beams.size();
        for (std::size_t i = 0; i < scan.range_m.size(); ++i) {
            const auto test_value = [&](const char* field, double value, double min, double max) {
                // -1: a fault of the log, not of one LiDAR.
                if (!(value >= min && value <= max)) report.add(-1, frame.index, i, field, value, min, max);
            };
            // An intensity above 0 needs a return, which is a range above 0.
            const auto test_return = [&](const char* range, const char* intensity, float range_m, float value,
                                         bool may_exist) {
                test_value(range, double(range_m), 0.0, may_exist ? kMaxDistance_m : 0.0);
                test_value(intensity, double(value), 0.0, range_m > 0.0f ? 1.0 : 0.0);
            };
            test_value("length of rays.origin", glm::length(glm::dvec3(scan.rays.origin[i])), 0.0,
                       kMaxOrigin_m);
            test_value("length of rays.direction", glm::length(glm::dvec3(scan.rays.direction[i])),
                       1.0 - kMaxLengthError, 1.0 + kMaxLengthError);
            test_value("rays.time_offset_s", double(scan.rays.time_offset_s[i]), -kMaxOffset_s, kMaxOffset_s);
            if (n_beams > 0) test_value("rays.channel", scan.rays.channel[i], 0.0, double(n_beams - 1));
            test_value("divergence", double(scan.rays.divergence_of_rad(i)), 0.0, kMaxDivergence_rad);
            test_return("range_m", "intensity", scan.range_m[i], scan.intensity[i], true);
            // A ray can have a second return only if it has a first one.
            for (const AdditionalReturns& second : scan.second_returns)
                test_return("second_returns.range_m", "second_returns.intensity", second.range_m[i],
                            second.intensity[i], scan.range_m[i] > 0.0f);
        }
    });
}

void test_box_sizes(const CheckedLog& log, const FaultReport& report) {
    for (const BoxTrack& box : log.sequence.boxes)
        if (const glm::dvec3 size_m = box.size_m; !(size_m.x > 0.0 && size_m.y > 0.0 && size_m.z > 0.0))
            report.add(-1, box.id, size_m.x, size_m.y, size_m.z);
}

void test_box_times(const CheckedLog& log, const FaultReport& report) {
    for (const BoxTrack& box : log.sequence.boxes) {
        const std::vector<double>& time_s = box.world_from_box.time_s;
        for (std::size_t k = 1; k < time_s.size(); ++k)
            if (!(time_s[k] > time_s[k - 1])) report.add(-1, box.id, k, time_s[k], time_s[k - 1]);
    }
}

/// Reports boxes that are too far from the vehicle, probably in map coordinates.
void test_box_places(const CheckedLog& log, const FaultReport& report) {
    for (const BoxTrack& box : log.sequence.boxes)
        for (std::size_t k = 0; k < box.world_from_box.pose.size(); ++k) {
            const double t_s = box.world_from_box.time_s[k];
            if (!log.sequence.world_from_vehicle.contains_time(t_s)) continue;
            const double distance_m = glm::distance(box.world_from_box.pose[k].translation,
                                                    log.sequence.world_from_vehicle.pose_at(t_s).translation);
            if (distance_m > kMaxBoxDistance_m) report.add(-1, box.id, k, distance_m, kMaxBoxDistance_m);
        }
}

}  // namespace relidar::checks
