// SPDX-License-Identifier: Apache-2.0
#include "simulate/render/sweep.hpp"

#include <cmath>
#include <deque>

#include <fmt/format.h>

#include <relidar/scene/labels.hpp>
#include "base/fail.hpp"

namespace relidar {
namespace {

constexpr double kBeyondPath_s = 1.0;    // limit from the firing of a ray to the nearest end of the path
constexpr double kMaxCoordinate = 1e10;  // limit of coordinates in metres and of times in s since 1970

/// Checks that the poses and times of a sensor or an actor are valid.
void check_track(const PoseTrack& track, const std::string& object_name) {
    const auto refuse = [&](const std::string& found, const char* expected) {
        fail("cannot render a scan: the poses of {} are invalid: found {}, expected {}", object_name, found,
             expected);
    };
    const std::size_t n_poses = track.pose.size();
    if (n_poses == 0 || n_poses != track.time_s.size())
        refuse(fmt::format("{} poses and {} times", n_poses, track.time_s.size()),
               "at least one pose, and exactly one time for each pose");
    for (std::size_t i = 0; i < n_poses; ++i) {
        const auto& [rotation, translation] = track.pose[i];
        bool is_pose = std::abs(glm::length(rotation) - 1.0) < 1e-3;
        for (const double value : {translation.x, translation.y, translation.z, track.time_s[i]})
            is_pose = is_pose && std::abs(value) <= kMaxCoordinate;
        if (!is_pose)
            refuse(fmt::format("an invalid pose at entry {}", i),
                   "a unit quaternion, and coordinates and times of at most 1e10");
        if (i > 0 && !(track.time_s[i] > track.time_s[i - 1])) {
            refuse(fmt::format("the time {} s of a pose directly after the time {} s of the previous pose",
                               track.time_s[i], track.time_s[i - 1]),
                   "times that increase from pose to pose");
        }
    }
}

/// Checks that the rays of a sweep are fired while the path of the sensor is known.
void check_path(const SimulatedSweep& sweep) {
    const std::vector<double>& times_s = sweep.world_from_sensor.time_s;
    if (times_s.size() < 2 || sweep.rays().size() == 0) return;
    const auto [first, last] = std::ranges::minmax(sweep.rays().time_offset_s);
    if (sweep.time_s + double(first) >= times_s.front() - kBeyondPath_s &&
        sweep.time_s + double(last) <= times_s.back() + kBeyondPath_s)
        return;
    fail(
        "cannot render a scan from {:.6g} to {:.6g} s: found poses from {:.6g} to {:.6g} s, expected poses "
        "that lack at most {} s at each end",
        sweep.time_s + double(first), sweep.time_s + double(last), times_s.front(), times_s.back(),
        kBeyondPath_s);
}

/// Returns the rays of a sweep if they differ from `sensor.rays`: if the pattern has
/// other rays in each scan, or if all rays are fired at the same time.
std::optional<RayTable> changed_rays_of(const SimulatedSensor& sensor, double time_s, bool is_rolling) {
    const bool has_varying_rays = sensor.pattern && sensor.rays.size() == 0;
    if (!has_varying_rays && is_rolling) return {};
    RayTable rays = has_varying_rays ? make_rays(*sensor.pattern, time_s) : sensor.rays;
    if (!is_rolling) std::ranges::fill(rays.time_offset_s, 0.0f);
    return rays;
}

std::vector<Frame> frames_with_shifts(const Log& log) {
    std::vector<Frame> frames;
    for (const Frame& frame : log.frames)
        if (!frame.azimuth_shift_rad.empty()) frames.push_back(strip_scan(frame));
    return frames;
}

}  // namespace

SimulatedSweepBuilder::SimulatedSweepBuilder(const Config& config, const Scene& scene, const Log& log)
    : config_(config),
      layout_(strip_surfels(scene)),
      log_world_from_vehicle_(log.world_from_vehicle),
      shifted_(frames_with_shifts(log)),
      n_logged_(scene.instances.size()),
      is_shown_(scene.instances.size(), true) {
    log_.lidars = log.lidars;
    log_.boxes = log.boxes;
    log_.world_offset_m = log.world_offset_m;
    log_.intensity_response = log.intensity_response;
    // Links each instance of the log to its labelled box by the name of the track.
    std::unordered_map<std::string_view, std::size_t> boxes;
    for (std::size_t i = 0; i < log_.boxes.size(); ++i) boxes.emplace(log_.boxes[i].id, i);
    for (std::size_t i = 0; i < n_logged_; ++i) {
        const std::string& track = layout_.instances[i].track;
        const auto box = boxes.find(track);
        box_of_.push_back(box == boxes.end() ? std::nullopt : std::optional(box->second));
        if (!track.empty()) instance_of_.emplace(track, std::uint32_t(i));
    }
}

void SimulatedSweepBuilder::add_model(const SurfelModel& model, const BoxTrack& box) {
    layout_.models.push_back(model);
    log_.boxes.push_back(box);
}

std::uint32_t SimulatedSweepBuilder::add_instance(std::uint32_t model) {
    layout_.instances.push_back({model, ""});
    is_shown_.push_back(false);
    return std::uint32_t(layout_.instances.size() - 1);
}

void SimulatedSweepBuilder::name_instance(std::uint32_t instance, const std::string& name) {
    std::string& track = layout_.instances[instance].track;
    instance_of_.erase(track);
    track = name;
    if (!name.empty()) instance_of_.emplace(name, instance);
    is_shown_[instance] = !name.empty();
}

std::uint32_t SimulatedSweepBuilder::find_actor(const std::string& name) const {
    const auto match = instance_of_.find(name);
    if (match == instance_of_.end()) fail_unknown_actor(name);
    return match->second;
}

void SimulatedSweepBuilder::fail_unknown_actor(const std::string& name) const {
    const std::vector<std::string> names = actor_names(layout_);
    fail<UsageError>("cannot find an actor: found track \"{}\", expected a track of the scene{}", name,
                     names.empty() ? ", which has no actors" : did_you_mean(name, names, "\""));
}

SimulatedSweepBuilder::InstanceTracks SimulatedSweepBuilder::logged_tracks(double time_s) const {
    InstanceTracks tracks(layout_.instances.size(), nullptr);
    for (std::size_t i = 0; i < n_logged_; ++i)
        if (box_of_[i] && log_.boxes[*box_of_[i]].is_observed(time_s))
            tracks[i] = &log_.boxes[*box_of_[i]].world_from_box;
    return tracks;
}

void SimulatedSweepBuilder::show_instances(const std::vector<bool>& shown) {
    if (shown.size() != n_logged_)
        fail<UsageError>("cannot select the objects to render: found {} values, expected {}", shown.size(),
                         n_logged_);
    std::copy(shown.begin(), shown.end(), is_shown_.begin());
}

SimulatedSensor SimulatedSweepBuilder::follow_log(const SimulatedSensor& sensor, double time_s) const {
    return follow_sweep(sensor, shifted_, log_.lidars, time_s);
}

/// Makes a sweep for a sensor on a given track, with the actors on their tracks. Changes
/// the vehicle of `log_`, which then has the poses of this sweep.
/// @param world_from_actor [instances] null if absent
SimulatedSweep SimulatedSweepBuilder::along_track(const SimulatedSensor& sensor, double time_s,
                                                  PoseTrack world_from_sensor,
                                                  const InstanceTracks& world_from_actor) {
    const bool is_rolling = relidar::is_rolling(sensor, config_);
    // The vehicle drives so that its LiDAR follows the track of the sensor.
    Lidar& lidar = log_.lidars[std::size_t(sensor.lidar)];
    lidar.pattern = sensor.pattern;
    log_.world_from_vehicle = mount_track(std::move(world_from_sensor), inverse(lidar.vehicle_from_sensor));
    log_.rolling_shutter = is_rolling;
    SimulatedSweep sweep{.sensor = sensor,
                         .time_s = time_s,
                         .changed_rays = changed_rays_of(sensor, time_s, is_rolling),
                         .world_from_sensor = log_.lidar_track(sensor.lidar)};
    sweep.pose = sweep.world_from_sensor.pose_at(time_s);
    if (is_rolling) check_path(sweep);
    else sweep.world_from_sensor = {{time_s}, {sweep.pose}};  // all rays are fired from this pose
    // Reads the changed log. The times of the instances depend on the azimuth at which
    // the sweep starts.
    const SweepTiming timing{time_s, sensor.lidar, find_sweep_start(sensor.rays, lidar)};
    sweep.instances = pose_instances(layout_, log_, timing, world_from_actor);
    for (std::size_t i = 0; i < sweep.instances.size(); ++i)
        if (!is_shown_[i]) sweep.instances[i].present = false;
    return sweep;
}

SimulatedSweep SimulatedSweepBuilder::on_recorded_path(const SimulatedSensor& sensor, double time_s,
                                                       const Pose& offset) {
    log_.world_from_vehicle = log_world_from_vehicle_;
    // Away from the LiDAR, a sensor moves on an arc in turns, which needs more poses.
    const bool is_elsewhere = offset.translation != glm::dvec3(0.0) || offset.rotation != Pose{}.rotation;
    const PoseTrack track = log_.lidar_track(sensor.lidar);
    return along_track(sensor, time_s, is_elsewhere ? mount_track(subdivide_turns(track), offset) : track,
                       logged_tracks(time_s));
}

SimulatedSweep SimulatedSweepBuilder::of_request(const SimulatedSensor& sensor, const ScanRequest& request) {
    // Requests are in the dataset's frame. The scene is in relidar's world frame.
    const auto to_scene_frame = [&](const PoseTrack& track, const std::string& object_name) {
        check_track(track, object_name);
        return shift_track(track, -log_.world_offset_m);
    };
    if (!(std::abs(request.time_s) <= kMaxCoordinate)) {
        fail("cannot render a scan: time_s: found {}, expected a finite time of at most {:.0e} s",
             request.time_s, kMaxCoordinate);
    }
    PoseTrack world_from_sensor = to_scene_frame(request.dataset_from_sensor, "the sensor");
    std::deque<PoseTrack> actor_tracks;  // a deque does not move the tracks to which `tracks` points
    InstanceTracks tracks(layout_.instances.size(), nullptr);
    if (!request.dataset_from_actor) tracks = logged_tracks(request.time_s);
    else
        for (const auto& [name, track] : *request.dataset_from_actor) {
            const auto [first, end] = instance_of_.equal_range(name);
            if (first == end) fail_unknown_actor(name);
            const PoseTrack& in_scene = actor_tracks.emplace_back(to_scene_frame(track, "actor " + name));
            // Several instances can have the same name.
            for (auto match = first; match != end; ++match) tracks[match->second] = &in_scene;
        }
    // Poses by handle replace those by name and those of the log.
    for (const auto& [actor, track] : request.placed) {
        const auto instance = std::size_t(actor);
        if (instance >= tracks.size() || layout_.instances[instance].track.empty())
            fail<UsageError>(
                "cannot place an actor: found the handle {}, expected that of an actor of the scene",
                instance);
        const std::string& name = layout_.instances[instance].track;
        tracks[instance] = &actor_tracks.emplace_back(to_scene_frame(track, "actor " + name));
    }
    return along_track(sensor, request.time_s, std::move(world_from_sensor), tracks);
}

float SimulatedSweepBuilder::permanent_drop(const SimulatedSensor& sensor, std::uint16_t channel,
                                            const glm::vec3& direction) const {
    const auto beam = sensor.is_log_lidar ? log_.find_global_beam(sensor.lidar, channel) : std::nullopt;
    return beam ? layout_.sensor_drop.probability_of(*beam, direction) : 0.0f;
}

RangeLimits SimulatedSweepBuilder::limits_of(const SimulatedSensor& sensor) const {
    return {sensor.limits.min_m,
            std::isfinite(sensor.limits.max_m) ? sensor.limits.max_m : config_.dataset.max_range_m};
}

}  // namespace relidar
