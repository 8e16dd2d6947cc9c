// SPDX-License-Identifier: Apache-2.0
// Interpolates poses and boxes, and computes rays and returns in the world frame.
//   pose(t): slerp / lerp between the neighbours of t; constant velocity at both ends.
#include <relidar/log/log.hpp>

#include <algorithm>
#include <cmath>
#include <complex>

#include <fmt/ranges.h>

#include "base/fail.hpp"
#include "base/parallel.hpp"

namespace relidar {

bool BoxTrack::is_observed(double t_s) const {
    const PoseTrack& track = world_from_box;
    if (track.pose.size() < 2) return track.contains_time(t_s);
    const double half_step =
        0.5 * (track.time_s.back() - track.time_s.front()) / static_cast<double>(track.time_s.size() - 1);
    return t_s >= track.time_s.front() - half_step && t_s <= track.time_s.back() + half_step;
}

BoxTrack BoxTrack::labelled_part() const {
    BoxTrack part = *this;
    part.n_before = part.n_after = 0;
    const auto first = std::ptrdiff_t(n_before), last = std::ptrdiff_t(world_from_box.pose.size() - n_after);
    part.world_from_box.time_s = {world_from_box.time_s.begin() + first,
                                  world_from_box.time_s.begin() + last};
    part.world_from_box.pose = {world_from_box.pose.begin() + first, world_from_box.pose.begin() + last};
    return part;
}

bool BoxTrack::contains_point(const glm::dvec3& point_m, double t_s, double margin_m) const {
    const glm::dvec3 half_m = 0.5 * size_m + glm::dvec3(margin_m);
    const PoseTrack& track = world_from_box;
    // For a moving box, first rejects points outside the bounding sphere. This fast test
    // avoids the slow interpolation of the rotation for most points.
    if (track.pose.size() > 1) {
        const TrackInterpolation at = track.find_segment(t_s);
        const glm::dvec3 centre_m =
            glm::mix(track.pose[at.left].translation, track.pose[at.left + 1].translation, at.s);
        const glm::dvec3 from_centre_m = point_m - centre_m;
        if (glm::dot(from_centre_m, from_centre_m) > glm::dot(half_m, half_m)) return false;
    }
    const glm::dvec3 local_m = glm::abs(inverse(track.pose_at(t_s)) * point_m);
    return local_m.x <= half_m.x && local_m.y <= half_m.y && local_m.z <= half_m.z;
}

/// Returns the two neighbouring poses of a time: the index of the earlier one, and how
/// far the time is between them, 0 to 1. Outside the track, it extrapolates from the
/// first or the last two poses, so the share is below 0 or above 1.
/// @throws DataError if the track is empty
TrackInterpolation PoseTrack::find_segment(double t_s) const {
    if (pose.empty() || pose.size() != time_s.size())
        fail("found a pose track with {} poses at {} times, expected the same number, at least one",
             pose.size(), time_s.size());
    if (pose.size() == 1) return {};
    const auto after = std::ranges::upper_bound(time_s, t_s) - time_s.begin();
    const auto left =
        std::size_t(std::clamp<std::ptrdiff_t>(after - 1, 0, std::ptrdiff_t(time_s.size()) - 2));
    const double span = time_s[left + 1] - time_s[left];
    return {left, span > 0.0 ? (t_s - time_s[left]) / span : 0.0};
}

Pose PoseTrack::pose_at(double t_s) const {
    const auto [left, s] = find_segment(t_s);
    return pose.size() == 1 ? pose.front() : interpolate(pose[left], pose[left + 1], s);
}

Pose PoseTrack::mounted_pose_at(double t_s, const Pose& carrier_from_mounted) const {
    const auto [left, s] = find_segment(t_s);
    return pose.size() == 1
               ? pose.front() * carrier_from_mounted
               : interpolate(pose[left] * carrier_from_mounted, pose[left + 1] * carrier_from_mounted, s);
}

std::size_t Scan::count_returns() const {
    return std::size_t(std::ranges::count_if(range_m, [](float r) { return r > 0.0f; }));
}

void limit_ranges(Scan& scan, const RangeLimits& limits) {
    for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray) {
        if (scan.range_m[ray] > 0.0f && !limits.contains(scan.range_m[ray])) {
            scan.range_m[ray] = 0.0f;
            scan.intensity[ray] = 0.0f;
            if (!scan.classes.empty()) scan.classes[ray] = SurfaceClass::unknown;
        }
        for (AdditionalReturns& second : scan.second_returns) {
            // A second return cannot exist without a first one.
            if (scan.range_m[ray] > 0.0f && limits.contains(second.range_m[ray])) continue;
            second.range_m[ray] = 0.0f;
            second.intensity[ray] = 0.0f;
        }
    }
}

std::size_t Log::find_pose_index(const Frame& frame) const {
    const std::vector<double>& times = world_from_vehicle.time_s;
    const auto at = std::ranges::lower_bound(times, frame.time_s);
    if (at == times.end() || *at != frame.time_s || times.size() != world_from_vehicle.pose.size())
        fail("{}: found {} poses of the vehicle at {} times, but no pose for frame {} at {} s", name,
             world_from_vehicle.pose.size(), times.size(), frame.index, frame.time_s);
    return std::size_t(at - times.begin());
}

PoseTrack Log::lidar_track(int lidar_index) const {
    return mount_track(world_from_vehicle, lidars[std::size_t(lidar_index)].vehicle_from_sensor);
}

int find_lidar(const Log& log, const std::string& name) {
    if (name.empty()) return 0;
    const auto lidar = std::ranges::find(log.lidars, name, &Lidar::name);
    if (lidar != log.lidars.end()) return static_cast<int>(lidar - log.lidars.begin());
    if (log.lidars.size() == 1)
        fail<UsageError>("lidar: found \"{}\", expected none, because the log has a single LiDAR", name);
    std::vector<std::string> names;
    for (const Lidar& other : log.lidars) names.push_back(other.name);
    fail<UsageError>("lidar: found \"{}\", expected one of {}", name, fmt::join(names, ", "));
}

std::size_t Log::count_beams() const {
    std::size_t n = 0;
    for (const Lidar& lidar : lidars) n += lidar.sensor.beams.size();
    return n;
}

std::optional<std::uint16_t> Log::find_global_beam(int lidar_index, std::uint16_t channel) const {
    std::size_t number = channel;
    if (number >= lidars[std::size_t(lidar_index)].sensor.beams.size()) return std::nullopt;
    for (int i = 0; i < lidar_index; ++i) number += lidars[std::size_t(i)].sensor.beams.size();
    return static_cast<std::uint16_t>(number);
}

const BoxTrack* find_box(const Log& log, const std::string& box_id) {
    if (box_id.empty()) return nullptr;
    const auto box = std::ranges::find(log.boxes, box_id, &BoxTrack::id);
    return box == log.boxes.end() ? nullptr : &*box;
}

Log strip_frames(const Log& log) {
    // Copies the other members one by one, because the scans can be gigabytes. The
    // binding needs all members, so without a new member it does not compile.
    const auto& [name, source, lidars, cameras, frames, world_from_vehicle, boxes, world_offset_m,
                 georeference, intensity_response, conventions, start_unix_ns, conventions_used, notes,
                 test_frames, has_poses, rolling_shutter] = log;
    return {.name = name,
            .source = source,
            .lidars = lidars,
            .cameras = cameras,
            .frames = {},
            .world_from_vehicle = world_from_vehicle,
            .boxes = boxes,
            .world_offset_m = world_offset_m,
            .georeference = georeference,
            .intensity_response = intensity_response,
            .conventions = conventions,
            .start_unix_ns = start_unix_ns,
            .conventions_used = conventions_used,
            .notes = notes,
            .test_frames = test_frames,
            .has_poses = has_poses,
            .rolling_shutter = rolling_shutter};
}

PoseTrack mount_track(PoseTrack carrier_track, const Pose& carrier_from_mounted) {
    for (Pose& pose : carrier_track.pose) pose = pose * carrier_from_mounted;
    return carrier_track;
}

PoseTrack subdivide_turns(const PoseTrack& track) {
    // Maximum rotation between two poses. Linear interpolation of an object 10 m away
    // then deviates by at most 0.03 mm from the true arc.
    constexpr double kMaxRotation_rad = 5e-3;
    PoseTrack fine;
    for (std::size_t i = 0; i < track.pose.size(); ++i) {
        if (i > 0) {
            const Pose &before = track.pose[i - 1], &after = track.pose[i];
            const double before_s = track.time_s[i - 1], step_s = track.time_s[i] - before_s;
            const Twist twist = compute_twist(before, after);  // translation, then rotation vector
            const double rotation_rad = glm::length(glm::dvec3(twist[3], twist[4], twist[5]));
            const int n_steps = 1 + static_cast<int>(rotation_rad / kMaxRotation_rad);
            for (int k = 1; k < n_steps; ++k) {
                const double share = double(k) / n_steps;
                fine.append(before_s + share * step_s, interpolate(before, after, share));
            }
        }
        fine.append(track.time_s[i], track.pose[i]);
    }
    return fine;
}

PoseTrack shift_track(PoseTrack track, const glm::dvec3& offset_m) {
    for (Pose& pose : track.pose) pose.translation += offset_m;
    return track;
}

bool BoxTrack::is_moving() const {
    constexpr double kAveraging_s = 1.0, kMaxJitter_m = 0.2, kMaxDrift_m = 2.0, kMaxDrift_mps = 0.5,
                     kTimeTolerance_s = 1e-6;
    const std::vector<double>& t = world_from_box.time_s;
    if (t.size() < 2) return false;
    // Positions are averaged over windows of this duration.
    const double window_s = std::min(kAveraging_s, 0.5 * (t.back() - t.front()));
    const double last_start_s = t.back() - window_s;  // the last window ends with the track
    // Largest distances of an object that may stand: between the first average and any
    // other one, and between averages of successive windows.
    const double max_drift_m =
        std::max(kMaxJitter_m, std::min(kMaxDrift_m, 0.5 * std::max(size_m.x, size_m.y)));
    const double max_step_m = std::max(kMaxJitter_m, kMaxDrift_mps * window_s);
    const auto compute_window_mean = [&](double first_s) -> std::optional<glm::dvec3> {
        const auto begin = std::ranges::lower_bound(t, first_s - kTimeTolerance_s);
        const auto end = std::ranges::upper_bound(t, first_s + window_s + kTimeTolerance_s);
        if (begin >= end) return std::nullopt;
        glm::dvec3 sum(0.0);
        for (auto at = begin; at != end; ++at)
            sum += world_from_box.pose[std::size_t(at - t.begin())].translation;
        return sum / double(end - begin);
    };
    const std::optional<glm::dvec3> start = compute_window_mean(t.front());
    for (const double time_s : t) {
        const double first_s = std::min(time_s, last_start_s);
        const double next_s = std::min(first_s + window_s, last_start_s);
        // The window of `here` contains at least the pose at `time_s`.
        const std::optional<glm::dvec3> here = compute_window_mean(first_s),
                                        next = compute_window_mean(next_s);
        if (glm::distance(*here, *start) > max_drift_m || (next && glm::distance(*next, *here) > max_step_m))
            return true;
        if (time_s >= last_start_s) break;
    }
    return false;
}

void set_trajectory(Log& log, PoseTrack world_from_vehicle) {
    for (BoxTrack& box : log.boxes)
        for (std::size_t k = 0; k < box.world_from_box.pose.size(); ++k) {
            const double t_s = box.world_from_box.time_s[k];
            Pose& world_from_box = box.world_from_box.pose[k];
            const Pose vehicle_from_box = inverse(log.world_from_vehicle.pose_at(t_s)) * world_from_box;
            world_from_box = world_from_vehicle.pose_at(t_s) * vehicle_from_box;
        }
    log.world_from_vehicle = std::move(world_from_vehicle);
}

namespace {

// If the start of a sweep differs from the default by at most this fraction of the
// period, the default start is used.
constexpr double kStartTolerance = 0.02;

double firing_time_s(double frame_time_s, const RayTable& rays, std::size_t ray, bool rolling_shutter) {
    return rolling_shutter ? frame_time_s + static_cast<double>(rays.time_offset_s[ray]) : frame_time_s;
}

WorldRay ray_to_world(const Pose& world_from_sensor, const RayTable& rays, std::size_t ray_index) {
    return {world_from_sensor * glm::dvec3(rays.origin[ray_index]),
            glm::normalize(world_from_sensor.rotation * glm::dvec3(rays.direction[ray_index]))};
}

/// Returns the azimuth at which a rotating head is at time 0, or nothing if the rays do
/// not come from one evenly rotating head. Each ray gives such an azimuth: its own minus
/// the rotation since then. The mean of these angles is the direction of the sum of their
/// unit vectors, because angles themselves jump by 2 pi.
std::optional<double> mean_azimuth_at_zero(const RayTable& rays, double rad_per_s) {
    // If the mean vector is shorter, the azimuths differ too much.
    constexpr double kMinMeanLength = 0.9;
    constexpr std::size_t kMaxUsedRays = 4096, kRaysPerPart = 256;  // enough for the mean
    // Uses every `step`-th ray.
    const std::size_t step = 1 + rays.size() / kMaxUsedRays, n_used = (rays.size() + step - 1) / step;
    const auto vector_sum = parallel_sum(n_used, kRaysPerPart, [&](std::size_t begin, std::size_t end) {
        std::complex<double> part = 0.0;
        for (std::size_t i = begin * step; i < std::min(end * step, rays.size()); i += step) {
            const double azimuth_rad = std::atan2(double(rays.direction[i].y), double(rays.direction[i].x));
            part += std::polar(1.0, azimuth_rad - rad_per_s * double(rays.time_offset_s[i]));
        }
        return part;
    });
    if (std::abs(vector_sum) < kMinMeanLength * double(n_used)) return {};
    return std::arg(vector_sum);
}

/// True if a sweep begins half a period before its reference time.
bool is_default_start(double first_s, double period_s) {
    return std::abs(first_s + 0.5 * period_s) < kStartTolerance * period_s;
}

}  // namespace

WorldRay make_world_ray(const PoseTrack& world_from_sensor, double time_s, const RayTable& rays,
                        std::size_t ray, bool rolling_shutter) {
    return ray_to_world(world_from_sensor.pose_at(firing_time_s(time_s, rays, ray, rolling_shutter)), rays,
                        ray);
}

std::optional<SweepStart> find_sweep_start(const RayTable& rays, const SpinningSensor& sensor) {
    if (!(sensor.period_s > 0.0) || rays.size() == 0) return {};
    const double rad_per_s = (sensor.clockwise ? -2.0 : 2.0) * kPi / sensor.period_s;
    const std::optional<double> azimuth_at_zero_rad = mean_azimuth_at_zero(rays, rad_per_s);
    if (!azimuth_at_zero_rad) return {};
    const double first_s = double(std::ranges::min(rays.time_offset_s));
    const bool faces_forward_at_zero = std::abs(*azimuth_at_zero_rad) < 2.0 * kPi * kStartTolerance;
    if (faces_forward_at_zero && is_default_start(first_s, sensor.period_s)) return {};
    return SweepStart{std::remainder(*azimuth_at_zero_rad + rad_per_s * first_s, 2.0 * kPi), first_s};
}

std::optional<SweepStart> find_sweep_start(const RayTable& rays, const Lidar& lidar) {
    if (!lidar.pattern) return find_sweep_start(rays, lidar.sensor);  // a rotating head
    // Other patterns have no head, so their start has only a time.
    const double period_s = lidar.sweep_period_s();
    if (!(period_s > 0.0) || rays.size() == 0) return {};
    const auto [first_s, last_s] = std::ranges::minmax(rays.time_offset_s);
    const bool is_unknown = first_s == last_s;  // all rays of a motion-compensated scan
    if (is_unknown || is_default_start(double(first_s), period_s)) return {};
    return SweepStart{.azimuth_rad = 0.0, .time_s = double(first_s)};
}

void set_sensor(Lidar& lidar, const SensorModel& sensor) {
    lidar.pattern = other_pattern(sensor);
    if (const auto* spinning = std::get_if<SpinningSensor>(&sensor.pattern)) {
        lidar.sensor = *spinning;
    } else {
        // Other patterns have no beams. Only name and range limits are stored here.
        lidar.sensor = {.name = sensor.name, .beams = {}, .columns = 0, .period_s = 0.0};
        lidar.sensor.min_range_m = sensor.limits.min_m;
        lidar.sensor.max_range_m = sensor.limits.max_m;
    }
}

SensorModel sensor_of(const Lidar& lidar) {
    const SpinningSensor& sensor = lidar.sensor;
    return {sensor.name, "", sensor.range_limits(), lidar.pattern ? *lidar.pattern : SensorPattern(sensor)};
}

RayTable make_lidar_rays(const Lidar& lidar, double time_s) {
    if (lidar.pattern) return make_rays(*lidar.pattern, time_s);
    return lidar.sensor.beams.empty() ? RayTable{} : make_rays(lidar.sensor);
}

namespace {

/// Returns the time at which the columns of a scanning window reach an azimuth. For other
/// patterns, it is the middle of the sweep.
double pattern_facing_time_s(const SensorPattern& pattern, double azimuth_rad, const SweepTiming& sweep) {
    const ScanPatternSummary summary = summarise_pattern(pattern);
    // Middle of the sweep, relative to sweep.time_s, which is the middle by default.
    // Otherwise `start` has the time of the first column.
    const double middle_s = sweep.start ? sweep.start->time_s + 0.5 * summary.period_s : 0.0;
    const bool has_columns = summary.sweep && summary.sweep->columns >= 2;
    if (!has_columns) return sweep.time_s + middle_s;  // for example, a rosette
    const auto [first_rad, last_rad, columns] = *summary.sweep;
    // Position of the azimuth between the first (0) and the last column (1).
    const double share = glm::clamp((azimuth_rad - first_rad) / (last_rad - first_rad), 0.0, 1.0);
    // Each column takes period / columns, so the first and the last one are
    // period * (columns - 1) / columns apart.
    const double after_middle_s = (share - 0.5) * summary.period_s * (columns - 1) / columns;
    return sweep.time_s + (middle_s + after_middle_s);
}

/// Returns the time at which a rotating head reaches an azimuth.
double head_facing_time_s(const SpinningSensor& sensor, double azimuth_rad, const SweepTiming& sweep) {
    if (sweep.start) {
        // Rotation from the start of the sweep to the azimuth, as a fraction of a full
        // rotation. Only the part from 0 to 1 counts, because a sweep is one rotation.
        const double rotations =
            (sensor.clockwise ? -1.0 : 1.0) * (azimuth_rad - sweep.start->azimuth_rad) / (2.0 * kPi);
        return sweep.time_s + sweep.start->time_s + (rotations - std::floor(rotations)) * sensor.period_s;
    }
    // By default, the head faces forward (azimuth 0) at the reference time.
    const double after_s = azimuth_rad / (2.0 * kPi) * sensor.period_s;
    return sweep.time_s + (sensor.clockwise ? -after_s : after_s);
}

}  // namespace

double facing_time_s(const Log& log, const glm::dvec3& point_m, const SweepTiming& sweep) {
    if (!log.rolling_shutter) return sweep.time_s;
    const Lidar& lidar = log.lidars[std::size_t(sweep.lidar)];
    const double azimuth_rad = std::atan2(point_m.y, point_m.x);
    return lidar.pattern ? pattern_facing_time_s(*lidar.pattern, azimuth_rad, sweep)
                         : head_facing_time_s(lidar.sensor, azimuth_rad, sweep);
}

SurfaceReturn surface_return(const Log& log, const Frame& frame, std::size_t ray, std::size_t index) {
    const Scan& scan = frame.scan;
    const Beam& beam = find_beam(log.lidar_of(frame).sensor.beams, scan.rays.channel[ray]);
    const double measured_m = index == 0 ? scan.range_m[ray] : scan.second_returns[index - 1].range_m[ray],
                 measured = index == 0 ? scan.intensity[ray] : scan.second_returns[index - 1].intensity[ray];
    const float range_m = static_cast<float>(beam.to_surface_range_m(measured_m));
    return {range_m, static_cast<float>(beam.to_surface_intensity(
                         measured, log.intensity_response.range_factor(double(range_m))))};
}

WorldReturn locate_return(const Log& log, const Frame& frame, std::size_t ray, std::size_t index) {
    const double t_s = firing_time_s(frame.time_s, frame.scan.rays, ray, log.rolling_shutter);
    const WorldRay w =
        ray_to_world(log.world_from_vehicle.mounted_pose_at(t_s, log.lidar_of(frame).vehicle_from_sensor),
                     frame.scan.rays, ray);
    const SurfaceReturn surface = surface_return(log, frame, ray, index);
    return {w.origin_m + static_cast<double>(surface.range_m) * w.direction, w.direction, t_s,
            surface.intensity};
}

bool is_in_moving_box(const std::vector<BoxTrack>& boxes, const glm::dvec3& p, double t_s, double margin_m) {
    return std::ranges::any_of(boxes, [&](const BoxTrack& box) {
        return box.is_observed(t_s) && box.contains_point(p, t_s, margin_m) && box.is_moving();
    });
}

}  // namespace relidar
