// SPDX-License-Identifier: Apache-2.0
// Tests for faults that make a log unusable, and the table of all checks of a loaded log.
// Later rows of the table rely on earlier rows.
#include "log/checks/checks.hpp"

#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include <relidar/log/checks.hpp>

#include "base/parallel.hpp"

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

void test_frames(const CheckedLog& checked, const FaultReport& report) {
    if (checked.log.frames.empty()) report.add();
}

void test_lidar_names(const CheckedLog& checked, const FaultReport& report) {
    std::set<std::string> names;
    for (const Lidar& lidar : checked.log.lidars)
        if (!names.insert(lidar.name).second) report.add(lidar.name);
}

void test_frame_numbers(const CheckedLog& checked, const FaultReport& report) {
    std::set<std::pair<int, int>> numbers;
    for (const Frame& frame : checked.log.frames)
        if (!numbers.insert({frame.lidar, frame.index}).second) report.add(frame.index);
}

void test_frame_times(const CheckedLog& checked, const FaultReport& report) {
    for (std::size_t i = 1; i < checked.log.frames.size(); ++i) {
        const Frame &before = checked.log.frames[i - 1], &frame = checked.log.frames[i];
        const double step_s = frame.time_s - before.time_s;
        if (!(step_s >= kMinStep_s) && !(step_s == 0.0 && frame.lidar > before.lidar))
            report.add(frame.index, frame.time_s, before.index, before.time_s, kMinStep_s);
    }
}

/// Tests all poses: the LiDAR mountings, the vehicle and the boxes.
void test_poses(const CheckedLog& checked, const FaultReport& report) {
    const auto test_pose = [&](const std::string& name, const Pose& pose) {
        const auto& [q, t] = pose;
        // NaN fails this comparison.
        if (!(glm::length(t) <= kMaxDistance_m && std::abs(glm::length(q) - 1.0) <= kMaxLengthError))
            report.add(name, t.x, t.y, t.z, glm::length(q), kMaxDistance_m);
    };
    const auto test_track = [&](const std::string& name, const PoseTrack& track) {
        for (std::size_t k = 0; k < track.pose.size(); ++k)
            test_pose(fmt::format("{}, pose {}", name, k), track.pose[k]);
    };
    for (const Lidar& lidar : checked.log.lidars)
        test_pose(fmt::format("LiDAR '{}', vehicle_from_sensor", lidar.name), lidar.vehicle_from_sensor);
    test_track("the vehicle", checked.log.world_from_vehicle);
    for (const BoxTrack& box : checked.log.boxes)
        test_track(fmt::format("box '{}'", box.id), box.world_from_box);
}

/// Tests that arrays of a scan have an entry per ray or, if optional, are empty.
void test_array_sizes(const CheckedLog& checked, const FaultReport& report) {
    for (const Frame& frame : checked.log.frames) {
        const Scan& scan = frame.scan;
        const RayTable& rays = scan.rays;
        const auto test_size = [&](const char* field, std::size_t size) {
            if (size != std::size_t(rays.rows) * std::size_t(rays.columns))
                report.add(frame.index, field, size, rays.rows, rays.columns);
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

/// Tests the values of one ray against their limits. NaN is outside all limits.
void test_ray(const Frame& frame, std::size_t ray, std::size_t n_beams, const FaultReport& report) {
    const Scan& scan = frame.scan;
    const auto test_value = [&](const char* field, double value, double min, double max) {
        if (!(value >= min && value <= max)) report.add(frame.index, ray, field, value, min, max);
    };
    test_value("length of rays.origin", glm::length(glm::dvec3(scan.rays.origin[ray])), 0.0, kMaxOrigin_m);
    test_value("length of rays.direction", glm::length(glm::dvec3(scan.rays.direction[ray])),
               1.0 - kMaxLengthError, 1.0 + kMaxLengthError);
    test_value("rays.time_offset_s", double(scan.rays.time_offset_s[ray]), -kMaxOffset_s, kMaxOffset_s);
    if (n_beams > 0) test_value("rays.channel", scan.rays.channel[ray], 0.0, double(n_beams - 1));
    test_value("divergence", double(scan.rays.divergence_of_rad(ray)), 0.0, kMaxDivergence_rad);

    // An intensity above 0 needs a return, which is a range above 0.
    const float range_m = scan.range_m[ray];
    test_value("range_m", double(range_m), 0.0, kMaxDistance_m);
    test_value("intensity", double(scan.intensity[ray]), 0.0, range_m > 0.0f ? 1.0 : 0.0);
    for (const AdditionalReturns& second : scan.second_returns) {
        // A ray can have a second return only if it has a first one.
        const float second_m = second.range_m[ray];
        test_value("second_returns.range_m", double(second_m), 0.0, range_m > 0.0f ? kMaxDistance_m : 0.0);
        test_value("second_returns.intensity", double(second.intensity[ray]), 0.0,
                   second_m > 0.0f ? 1.0 : 0.0);
    }
}

void test_rays(const CheckedLog& checked, const FaultReport& report) {
    parallel_for(int(checked.log.frames.size()), [&](int index) {
        const Frame& frame = checked.log.frames[std::size_t(index)];
        const std::size_t n_beams = checked.log.lidar_of(frame).sensor.beams.size();
        for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray)
            test_ray(frame, ray, n_beams, report);
    });
}

void test_box_sizes(const CheckedLog& checked, const FaultReport& report) {
    for (const BoxTrack& box : checked.log.boxes)
        if (const glm::dvec3 size_m = box.size_m;
            !(size_m.x > 0.0 && size_m.y > 0.0 && size_m.z > 0.0 && glm::length(size_m) < INFINITY))
            report.add(box.id, size_m.x, size_m.y, size_m.z);
}

void test_box_times(const CheckedLog& checked, const FaultReport& report) {
    for (const BoxTrack& box : checked.log.boxes) {
        const std::vector<double>& time_s = box.world_from_box.time_s;
        for (std::size_t k = 1; k < time_s.size(); ++k)
            if (!(time_s[k] > time_s[k - 1])) report.add(box.id, k, time_s[k], time_s[k - 1]);
    }
}

/// Reports boxes that are too far from the vehicle, probably in map coordinates.
void test_box_places(const CheckedLog& checked, const FaultReport& report) {
    const PoseTrack& vehicle = checked.log.world_from_vehicle;
    for (const BoxTrack& box : checked.log.boxes) {
        const PoseTrack& track = box.world_from_box;
        for (std::size_t k = 0; k < track.pose.size(); ++k) {
            if (!vehicle.contains_time(track.time_s[k])) continue;
            const double distance_m =
                glm::distance(track.pose[k].translation, vehicle.pose_at(track.time_s[k]).translation);
            if (distance_m > kMaxBoxDistance_m) report.add(box.id, k, distance_m, kMaxBoxDistance_m);
        }
    }
}

/// Counts the returns of a scan, and finds their lowest and highest intensity.
ReturnStatistics count_returns(const Scan& scan) {
    ReturnStatistics statistics;
    for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray) {
        if (!(scan.range_m[ray] > 0.0f)) continue;
        ++statistics.n_returns;
        if (scan.intensity[ray] == 1.0f) ++statistics.n_at_maximum;
        statistics.lowest = std::min(statistics.lowest, scan.intensity[ray]);
        statistics.highest = std::max(statistics.highest, scan.intensity[ray]);
    }
    return statistics;
}

constexpr Check kChecks[] = {
    {"frames", test_frames, "found no frame, expected at least one frame", true},
    {"lidar_names", test_lidar_names, "found two LiDARs with the name '{}', expected different names", true},
    {"frame_numbers", test_frame_numbers,
     "frame {}: found a second frame with this number, expected each number once for each LiDAR", true},
    {"frame_times", test_frame_times,
     "frame {}: found the time {} s after frame {} at {} s, expected a time at least {} s later, or the same "
     "time and a higher LiDAR index",
     true},
    {"clock_jump", test_clock_jump,
     "frame {}: found a time {:.1f} s after frame {}, expected a step of at most {} s (the median step is "
     "{:.3g} s); use --frames to select frames before or after the gap",
     true},
    {"poses", test_poses,
     "{}: found the position ({}, {}, {}) and a quaternion of length {}, expected a position at most {} m "
     "from the origin of the world and length 1",
     true},
    {"array_sizes", test_array_sizes, "frame {}, {}: found {} entries, expected {} x {}", true},
    {"rays", test_rays, "frame {}, ray {}, {}: found {}, expected {} to {}", true},
    {"box_sizes", test_box_sizes, "box '{}': found the size {} x {} x {} m, expected sides above 0 m", true},
    {"box_times", test_box_times,
     "box '{}', pose {}: found the time {} s after the time {} s, expected increasing times", true},
    {"box_places", test_box_places,
     "box '{}', pose {}: found a distance of {:.0f} m from the vehicle, expected at most {} m, because boxes "
     "and vehicle poses must be in the same world frame",
     true},
    {"time_gaps", test_time_gaps,
     "the frame times have {} gaps of more than a second; the longest is {:.1f} s, between frames {} and {} "
     "(the median step is {:.3g} s); poses in gaps are interpolated"},
    {"time_unit", test_time_unit,
     "the unit of the times is probably wrong: frames are {:.6g} s apart, but a sweep takes {:.3g} s; the "
     "times of frames seem to be in {}, expected seconds"},
    {"speed", test_speed,
     "the poses or their times are probably wrong: the vehicle moves faster than {} m/s in {} of {} steps "
     "between frames, and at {:.0f} m/s from frame {} to frame {}; expected positions in metres and times in "
     "seconds"},
    {"float_positions", test_float_positions,
     "the positions of the vehicle have lost their precision: all {} coordinates are multiples of {:.3g} m, "
     "which is the precision of float32 at {:.0f} m; expected double precision"},
    {"few_returns", test_few_returns,
     "some scans are probably incomplete: {} of {} scans have fewer than half of the returns of neighbouring "
     "scans; frame {} has only {} instead of about {}"},
    {"rotation", test_rotation,
     "the direction of rotation is probably wrong: by the times of the points, the head turns {}, but its "
     "sensor turns {}; check the sign of the times and of y"},
    {"equal_intensities", test_equal_intensities,
     "all intensities of the log are {:.4g} of the maximum, so rendered intensities have no meaning"},
    {"dark", test_dark,
     "the scale of the intensities is probably wrong: they reach only {:.3g} of the maximum, so all returns "
     "are very dark; conventions.intensity_max sets the intensity that becomes 1"},
    {"saturated", test_saturated,
     "the scale of the intensities is probably wrong: {:.0f} % of the returns have the maximum intensity"},
    {"own_body", test_own_body, "{}"},
    {"box_convention", test_box_convention, "the boxes are probably wrong: {}"},
};

}  // namespace

void note_faults(Log& log) {
    CheckedLog checked{log, std::vector<ReturnStatistics>(log.frames.size())};
    parallel_for(int(checked.scans.size()), [&](int index) {
        checked.scans[std::size_t(index)] = count_returns(log.frames[std::size_t(index)].scan);
    });
    for (const Check& check : kChecks)
        if (!check.is_error) check.test(checked, {check, log, log.notes});
}

}  // namespace relidar::checks

namespace relidar {

void check_log(const Log& log) {
    Notes none;
    for (const checks::Check& check : checks::kChecks)
        if (check.is_error) check.test({log}, {check, log, none});
}

}  // namespace relidar
