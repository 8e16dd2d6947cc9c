// SPDX-License-Identifier: Apache-2.0
// Checks a loaded log for invalid values, whatever the dataset is. An error message is
// one line: frame or box, field, value, and expected value.
#include <relidar/log/clouds.hpp>

#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include "base/fail.hpp"
#include "base/parallel.hpp"

namespace relidar {
namespace {

// Maximum difference between 1 and the length of a direction or quaternion.
constexpr double kUnit = 1e-3;
// Minimum time between poses. With less time, velocities would be mostly noise.
constexpr double kLeastStep_s = 1e-3;
constexpr double kLongestOffset_s = 10.0;  // maximum time between the firing of a ray and its frame
// Upper limit of ranges, and of distances from the origin of the world.
constexpr double kFarthest_m = 1e6;
constexpr double kBoxReach_m =
    // Maximum distance between a box and the vehicle. Boxes that are in map coordinates
    // by mistake are usually farther away.
    1e5;
// maximum distance between the origin of a ray and the sensor
constexpr double kLargestOrigin_m = 1000.0;
constexpr double kWidestBeam_rad = 6.3;  // maximum divergence of a beam, as a full angle

[[noreturn]] void fail_at(const std::string& error_location, const std::string& found_value,
                          const std::string& expected) {
    fail("{}: found {}, expected {}", error_location, found_value, expected);
}

bool is_finite(const glm::dvec3& vector) {
    return std::isfinite(vector.x) && std::isfinite(vector.y) && std::isfinite(vector.z);
}

void require_valid_pose(const Pose& pose, const std::string& error_location) {
    const double largest =
        std::max({std::abs(pose.translation.x), std::abs(pose.translation.y), std::abs(pose.translation.z)});
    if (!is_finite(pose.translation) || largest > kFarthest_m)
        fail_at(error_location,
                fmt::format("the position ({}, {}, {})", pose.translation.x, pose.translation.y,
                            pose.translation.z),
                fmt::format("coordinates of at most {} m from the origin of the world", kFarthest_m));
    if (!(std::abs(glm::length(pose.rotation) - 1.0) <= kUnit))
        fail_at(error_location, fmt::format("a quaternion of length {}", glm::length(pose.rotation)),
                "length 1");
}

/// Checks a track. Its times must increase, and each time must have one pose.
void require_valid_pose_track(const PoseTrack& track, const std::string& error_location) {
    if (track.pose.empty() || track.pose.size() != track.time_s.size())
        fail_at(error_location, fmt::format("{} poses and {} times", track.pose.size(), track.time_s.size()),
                "at least one pose, and as many times as poses");
    for (std::size_t k = 0; k < track.pose.size(); ++k) {
        const double before = k == 0 ? -INFINITY : track.time_s[k - 1];
        if (!std::isfinite(track.time_s[k]) || !(track.time_s[k] > before))
            fail_at(fmt::format("{}, pose {}", error_location, k),
                    fmt::format("the time {} s after the time {} s", track.time_s[k], before),
                    "finite and increasing times");
        require_valid_pose(track.pose[k], fmt::format("{}, pose {}", error_location, k));
    }
}

void require_valid_lidars(const LidarSequence& sequence) {
    if (sequence.lidars.empty()) fail_at(sequence.name, "no LiDAR", "at least one LiDAR");
    std::set<std::string> names;
    for (const Lidar& lidar : sequence.lidars) {
        const std::string where = fmt::format("{}: LiDAR '{}'", sequence.name, lidar.name);
        if (!names.insert(lidar.name).second)
            fail_at(where, "another LiDAR with this name", "different names of LiDARs");
        require_valid_pose(lidar.vehicle_from_sensor, where + ", vehicle_from_sensor");
        const SpinningSensor& sensor = lidar.sensor;
        if (sensor.beams.empty() != (sensor.columns == 0))
            fail_at(where, fmt::format("{} beams and {} columns", sensor.beams.size(), sensor.columns),
                    "two numbers above 0, or both 0 for a sensor that does not spin");
        if (!(sensor.period_s >= 0.0 && sensor.period_s < kLongestOffset_s))
            fail_at(where, fmt::format("a sweep period of {} s", sensor.period_s),
                    fmt::format("a sweep period from 0 to {} s", kLongestOffset_s));
        if (!sensor.beams.empty()) make_rays(sensor);
    }
}

void require_valid_frames_and_pose_times(const LidarSequence& sequence) {
    const std::vector<double>& times = sequence.world_from_vehicle.time_s;
    if (sequence.frames.empty()) fail_at(sequence.name, "no frame", "at least one frame");
    std::set<std::pair<int, int>> numbers;
    std::size_t pose = 0;
    for (std::size_t i = 0; i < sequence.frames.size(); ++i) {
        const LidarFrame& frame = sequence.frames[i];
        const std::string where = fmt::format("{}: frame {}", sequence.name, frame.index);
        if (frame.lidar < 0 || std::size_t(frame.lidar) >= sequence.lidars.size())
            fail_at(where, fmt::format("the LiDAR index {}", frame.lidar),
                    fmt::format("the index of a LiDAR, 0 to {}", sequence.lidars.size() - 1));
        if (!numbers.insert({frame.lidar, frame.index}).second)
            fail_at(where, "a second frame with the same number and LiDAR",
                    "each frame number only once for each LiDAR");
        if (i > 0) {
            const LidarFrame& before = sequence.frames[i - 1];
            const double step_s = frame.time_s - before.time_s;
            if (!(step_s >= kLeastStep_s) && !(step_s == 0.0 && frame.lidar > before.lidar))
                fail_at(where,
                        fmt::format("the time {} s, but the previous frame {} has the time {} s",
                                    frame.time_s, before.index, before.time_s),
                        fmt::format("a time at least {} s after the previous frame, or the same time with a "
                                    "higher LiDAR index",
                                    kLeastStep_s));
            pose += step_s != 0.0;
        }
        if (pose >= times.size() || times[pose] != frame.time_s)
            fail_at(where, fmt::format("no pose of the vehicle at {} s", frame.time_s),
                    "one pose for the time of each frame");
    }
    if (pose + 1 != times.size())
        fail_at(sequence.name, fmt::format("{} poses of the vehicle", times.size()),
                fmt::format("{} poses of the vehicle, one for the time of each frame", pose + 1));
}

void require_matching_scan_array_sizes(const Scan& scan, const std::string& error_location) {
    const RayTable& rays = scan.rays;
    if (rays.rows < 0 || rays.columns < 0 || std::size_t(rays.rows) * std::size_t(rays.columns) > kMaxRays)
        fail_at(error_location,
                fmt::format("a range image with {} rows and {} columns", rays.rows, rays.columns),
                fmt::format("at most {} rays in a range image", kMaxRays));
    const std::size_t n = std::size_t(rays.rows) * std::size_t(rays.columns);
    const auto check = [&](const char* field, std::size_t size) {
        if (size != n)
            fail_at(fmt::format("{}, {}", error_location, field), fmt::format("{} entries", size),
                    fmt::format("{} x {} entries", rays.rows, rays.columns));
    };
    check("rays.origin", rays.origin.size());
    check("rays.direction", rays.direction.size());
    check("rays.time_offset_s", rays.time_offset_s.size());
    check("rays.channel", rays.channel.size());
    if (!rays.ray_divergence_rad.empty()) check("rays.ray_divergence_rad", rays.ray_divergence_rad.size());
    check("range_m", scan.range_m.size());
    check("intensity", scan.intensity.size());
    if (!scan.classes.empty()) check("classes", scan.classes.size());
    for (const AdditionalReturns& f : scan.second_returns) {
        check("second_returns.range_m", f.range_m.size());
        check("second_returns.intensity", f.intensity.size());
    }
}

/// Returns the name of the invalid field of a return: "range_m" or "intensity". Returns
/// null if range and intensity are valid.
const char* find_name_of_invalid_return_field(float range_m, float intensity) {
    if (!(range_m >= 0.0f && range_m <= kFarthest_m)) return "range_m";
    if (!(intensity >= 0.0f && intensity <= (range_m > 0.0f ? 1.0f : 0.0f))) return "intensity";
    return nullptr;
}

void require_valid_scan(const Scan& scan, std::size_t n_beams, const std::string& error_location) {
    require_matching_scan_array_sizes(scan, error_location);
    for (std::size_t i = 0; i < scan.range_m.size(); ++i) {
        const auto ray = [&](const char* field) {
            return fmt::format("{}, ray {}, {}", error_location, i, field);
        };
        const glm::dvec3 origin(scan.rays.origin[i]), direction(scan.rays.direction[i]);
        if (!is_finite(origin) || glm::length(origin) > kLargestOrigin_m)
            fail_at(ray("rays.origin"), fmt::format("({}, {}, {})", origin.x, origin.y, origin.z),
                    fmt::format("coordinates of at most {} m from the sensor", kLargestOrigin_m));
        if (!(std::abs(glm::length(direction) - 1.0) <= kUnit))
            fail_at(ray("rays.direction"),
                    fmt::format("a direction vector of length {}", glm::length(direction)),
                    "a direction vector of length 1");
        if (!(std::abs(scan.rays.time_offset_s[i]) <= kLongestOffset_s))
            fail_at(ray("rays.time_offset_s"), fmt::format("{} s", scan.rays.time_offset_s[i]),
                    fmt::format("an offset of at most {} s from the time of the frame", kLongestOffset_s));
        if (n_beams > 0 && scan.rays.channel[i] >= n_beams)
            fail_at(ray("rays.channel"), fmt::format("{}", scan.rays.channel[i]),
                    fmt::format("the index of one of {} beams", n_beams));
        if (const double angle = scan.rays.get_beam_divergence_rad(i);
            !(angle >= 0.0 && angle <= kWidestBeam_rad))
            fail_at(ray("divergence"), fmt::format("{}", angle),
                    fmt::format("a beam divergence from 0 to {} rad", kWidestBeam_rad));
        if (const char* field = find_name_of_invalid_return_field(scan.range_m[i], scan.intensity[i]))
            fail_at(ray(field),
                    fmt::format("a range of {} m and an intensity of {}", scan.range_m[i], scan.intensity[i]),
                    "a range above 0 m and an intensity from 0 to 1, or both 0 for a dropped ray");
        for (const AdditionalReturns& f : scan.second_returns)
            if (find_name_of_invalid_return_field(f.range_m[i], f.intensity[i]) ||
                (scan.range_m[i] == 0.0f && f.range_m[i] != 0.0f))
                fail_at(ray("second return"),
                        fmt::format("a range of {} m and an intensity of {} for the second return, and a "
                                    "range of {} m for the first return",
                                    f.range_m[i], f.intensity[i], scan.range_m[i]),
                        "a second return with a range above 0 m and an intensity from 0 to 1, or a range and "
                        "an intensity of 0 if the ray has fewer than two returns");
    }
}

void require_valid_boxes(const LidarSequence& sequence) {
    std::set<std::string> ids;
    for (const BoxTrack& box : sequence.boxes) {
        const std::string where = fmt::format("{}: box '{}'", sequence.name, box.id);
        if (box.id.empty() || !ids.insert(box.id).second)
            fail_at(where, "an id that is empty or occurs twice", "a different id for each box");
        if (!is_finite(box.size_m) || !(std::min({box.size_m.x, box.size_m.y, box.size_m.z}) > 0.0))
            fail_at(where,
                    fmt::format("the box size {} x {} x {} m", box.size_m.x, box.size_m.y, box.size_m.z),
                    "a length, a width and a height above 0 m");
        require_valid_pose_track(box.world_from_box, where);
        for (std::size_t k = 0; k < box.world_from_box.pose.size(); ++k) {
            const double t_s = box.world_from_box.time_s[k];
            // Skips labels with a time before the first frame or after the last frame.
            if (!sequence.world_from_vehicle.contains_time(t_s)) continue;
            const double distance_m =
                glm::distance(box.world_from_box.pose[k].translation,
                              sequence.world_from_vehicle.interpolate_pose(t_s).translation);
            if (distance_m > kBoxReach_m)
                fail_at(fmt::format("{}, pose {}", where, k),
                        fmt::format("a distance of {:.0f} m from the vehicle", distance_m),
                        fmt::format("a distance of at most {} m, because boxes and vehicle poses must be in "
                                    "the same world frame",
                                    kBoxReach_m));
        }
    }
}

/// Two consecutive frames whose time step is much longer than usual.
struct FrameGap {
    const LidarFrame *before, *after;
    double get_duration_s() const { return after->time_s - before->time_s; }
};

}  // namespace

void add_notes_about_time_gaps(LidarSequence& sequence) {
    constexpr double kGap_s = 1.0, kJump_s = 60.0, kUsualSteps = 10.0;
    std::vector<FrameGap> steps;
    for (std::size_t i = 1; i < sequence.frames.size(); ++i)
        if (const FrameGap step{&sequence.frames[i - 1], &sequence.frames[i]}; step.get_duration_s() > 0.0)
            steps.push_back(step);
    if (steps.empty()) return;
    std::vector<FrameGap> sorted = steps;
    std::ranges::sort(sorted, {}, &FrameGap::get_duration_s);
    const double usual_s = sorted[(sorted.size() - 1) / 2].get_duration_s();
    std::erase_if(steps, [&](const FrameGap& gap) {
        return gap.get_duration_s() <= std::max(kGap_s, kUsualSteps * usual_s);
    });
    if (steps.empty()) return;
    const FrameGap longest = *std::ranges::max_element(steps, {}, &FrameGap::get_duration_s);
    const int before = longest.before->index, after = longest.after->index;
    if (longest.get_duration_s() > kJump_s)
        fail_at(fmt::format("{}: frame {}", sequence.name, after),
                fmt::format("the time {} s, which is {:.1f} s after frame {}", longest.after->time_s,
                            longest.get_duration_s(), before),
                fmt::format("a step of at most {} s (the median step is {:.3g} s); use --frames to select "
                            "frames before or after the gap",
                            kJump_s, usual_s));
    sequence.notes.push_back(Note("time_gaps", -1,
                                  fmt::format("the sequence of frame times has {} gap{}; the longest is "
                                              "{:.1f} s, between frames {} and {} (the "
                                              "median step is {:.3g} s); poses in gaps are interpolated",
                                              steps.size(), steps.size() > 1 ? "s" : "",
                                              longest.get_duration_s(), before, after, usual_s)));
}

void require_valid_sequence(const LidarSequence& sequence) {
    require_valid_lidars(sequence);
    require_valid_pose_track(sequence.world_from_vehicle, sequence.name + ": the vehicle");
    require_valid_frames_and_pose_times(sequence);
    parallel_for(static_cast<int>(sequence.frames.size()), [&](int index) {
        const LidarFrame& frame = sequence.frames[std::size_t(index)];
        require_valid_scan(frame.scan, sequence.get_lidar(frame).sensor.beams.size(),
                           fmt::format("{}: frame {}", sequence.name, frame.index));
    });
    require_valid_boxes(sequence);
}

}  // namespace relidar
