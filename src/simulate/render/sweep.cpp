// SPDX-License-Identifier: Apache-2.0
#include "simulate/render/sweep.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

namespace relidar {
namespace {

constexpr double kFarthest = 1e10;  // limit for coordinates in metres and for times in seconds since 1970

/// Checks the track of a sensor or an actor.
/// @param thing name of the object in the error message
/// @throws DataError if poses or times are invalid
void check_track(const PoseTrack& track, const std::string& thing) {
    const auto fail = [&](const std::string& found, const char* expected) {
        throw DataError(
            fmt::format("cannot render a scan: poses of {}: found {}, expected {}", thing, found, expected));
    };
    const std::size_t n = track.pose.size();
    if (n == 0 || n != track.time_s.size())
        fail(fmt::format("{} poses and {} times", n, track.time_s.size()),
             "the same number of poses and times, and at least one");
    for (std::size_t i = 0; i < n; ++i) {
        const auto& [q, t] = track.pose[i];
        bool is_pose = std::abs(glm::length(q) - 1.0) < 1e-3;
        for (const double x : {t.x, t.y, t.z, track.time_s[i]}) is_pose = is_pose && std::abs(x) <= kFarthest;
        if (!is_pose)
            fail(fmt::format("an invalid pose at entry {}", i),
                 "a unit quaternion, and coordinates and times of at most 1e10");
        if (i > 0 && !(track.time_s[i] > track.time_s[i - 1])) {
            fail(fmt::format("the time {} s after the time {} s", track.time_s[i], track.time_s[i - 1]),
                 "increasing times");
        }
    }
}

Sequence copy_without_scans(const Sequence& sequence) {
    Sequence result;
    result.lidars = sequence.lidars;
    result.boxes = sequence.boxes;
    result.world_offset_m = sequence.world_offset_m;
    result.intensity_response = sequence.intensity_response;
    return result;
}

std::vector<Frame> shift_frame_times(const Sequence& sequence) {
    std::vector<Frame> frames;
    for (const Frame& frame : sequence.frames)
        if (!frame.azimuth_shift_rad.empty()) frames.push_back(copy_without_scan(frame));
    return frames;
}

std::optional<RayTable> make_changed_rays(const SensorChoice& sensor, double time_s, bool rolls) {
    const bool makes_rays = sensor.pattern && sensor.rays.size() == 0;
    if (rolls && !makes_rays) return {};
    RayTable rays = makes_rays ? make_rays(*sensor.pattern, time_s) : sensor.rays;
    if (!rolls) std::ranges::fill(rays.time_offset_s, 0.0f);
    return rays;
}

}  // namespace

SweepMaker::SweepMaker(const Config& config, const Scene& scene, const Sequence& sequence)
    : config_(config),
      layout_(copy_layout(scene)),
      log_(copy_without_scans(sequence)),
      log_world_from_vehicle_(sequence.world_from_vehicle),
      shifted_(shift_frame_times(sequence)),
      shown_(scene.instances.size(), true) {}

void SweepMaker::set_visible_instances(const std::vector<bool>& shown) {
    if (shown.size() != shown_.size())
        throw UsageError(
            fmt::format("cannot select the rendered instances: found {} choices, expected {}, one for each "
                        "instance",
                        shown.size(), shown_.size()));
    shown_ = shown;
}

SensorChoice SweepMaker::align_with_log(const SensorChoice& sensor, double time_s) const {
    return align_sensor_with_sweep(sensor, shifted_, log_.lidars, time_s);
}

PoseTrack SweepMaker::convert_to_dataset(const PoseTrack& world_from_thing) const {
    return shift_track(world_from_thing, log_.world_offset_m);
}

/// Makes a sweep for a sensor that follows a given track. Moves the vehicle with the
/// sensor.
/// @param world_from_actor poses of the actors; if null, uses the tracks of the run
Sweep SweepMaker::drive(const SensorChoice& sensor, double time_s, PoseTrack world_from_sensor,
                        const ActorPoses* world_from_actor) {
    Lidar& lidar = log_.lidars[std::size_t(sensor.lidar)];
    log_.world_from_vehicle =
        mount_on_track(std::move(world_from_sensor), inverse(lidar.vehicle_from_sensor));
    log_.rolling_shutter = has_rolling_shutter(sensor, config_);
    lidar.pattern = sensor.pattern;
    // The pattern of the sensor determines at which azimuth the sweep starts. Without a
    // pattern, the LiDAR that the sensor replaces determines it.
    const SweepMoment now{time_s, sensor.lidar, find_sweep_start(sensor.rays, lidar)};
    Sweep sweep{sensor, time_s, make_changed_rays(sensor, time_s, log_.rolling_shutter),
                log_.world_from_sensor(sensor.lidar)};
    sweep.pose = sweep.world_from_sensor.at(time_s);
    if (!log_.rolling_shutter) sweep.world_from_sensor = {{time_s}, {sweep.pose}};
    sweep.instances = world_from_actor ? place_instances(layout_, log_, now, *world_from_actor)
                                       : place_instances(layout_, log_, now);
    for (std::size_t i = 0; i < sweep.instances.size(); ++i)
        sweep.instances[i].present = sweep.instances[i].present && shown_[i];
    return sweep;
}

Sweep SweepMaker::make(const SensorChoice& sensor, double time_s, const Pose& sensor_offset) {
    log_.world_from_vehicle = log_world_from_vehicle_;
    const bool is_elsewhere =
        sensor_offset.translation != glm::dvec3(0.0) || sensor_offset.rotation != Pose{}.rotation;
    const PoseTrack track = log_.world_from_sensor(sensor.lidar);
    return drive(sensor, time_s, is_elsewhere ? mount_on_track(refine_turns(track), sensor_offset) : track,
                 nullptr);
}

Sweep SweepMaker::make(const SensorChoice& sensor, const ScanRequest& request) {
    const auto in_world = [&](const PoseTrack& dataset_from_thing, const std::string& thing) {
        check_track(dataset_from_thing, thing);
        return shift_track(dataset_from_thing, -log_.world_offset_m);
    };
    if (!(std::abs(request.time_s) <= kFarthest)) {
        throw DataError(
            fmt::format("cannot render a scan: time_s: found {}, expected a finite time of at most {:.0e} s",
                        request.time_s, kFarthest));
    }
    PoseTrack world_from_sensor = in_world(request.dataset_from_sensor, "the sensor");
    ActorPoses world_from_actor;
    if (request.dataset_from_actor)
        for (const auto& [name, track] : *request.dataset_from_actor)
            world_from_actor[name] = in_world(track, "actor " + name);
    return drive(sensor, request.time_s, std::move(world_from_sensor),
                 request.dataset_from_actor ? &world_from_actor : nullptr);
}

float SweepMaker::get_permanent_drop_probability(const SensorChoice& sensor, std::uint16_t channel,
                                                 const glm::vec3& direction) const {
    const auto own_beam = sensor.is_own ? log_.find_beam_number(sensor.lidar, channel) : std::nullopt;
    return own_beam ? layout_.sensor_drop.at(*own_beam, direction) : 0.0f;
}

RangeLimits SweepMaker::get_limits(const SensorChoice& sensor) const {
    return {sensor.limits.min_m,
            std::isfinite(sensor.limits.max_m) ? sensor.limits.max_m : config_.dataset.max_range_m};
}

}  // namespace relidar
