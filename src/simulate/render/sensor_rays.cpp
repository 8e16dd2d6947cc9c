// SPDX-License-Identifier: Apache-2.0
// Runs the kernels fire_rays, measure_rays and drop_channels of simulate/render. They
// compute world rays, measurements, and the inputs of ray-drop networks.
#include "simulate/render/sensor_rays.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/parallel.hpp"

namespace relidar {
namespace {

/// Returns true if two tables have the same bytes. Compares in parallel, because a ray
/// table has several megabytes.
template <class Values>
bool are_bytes_equal(const Values& first, const Values& second) {
    if (first.size() != second.size()) return false;
    constexpr std::size_t kValuesPerTask = 1 << 14;  // number of values in each parallel part
    std::atomic<bool> are_equal{true};
    parallel_ranges(first.size(), kValuesPerTask, [&](std::size_t begin, std::size_t end) {
        if (!are_equal) return;  // another part differs
        const std::size_t n_bytes = (end - begin) * sizeof(first[0]);
        if (std::memcmp(&first[begin], &second[begin], n_bytes) != 0) are_equal = false;
    });
    return are_equal;
}

/// Returns the calibration and the actor logit of each beam. One list can be longer than
/// the other: beams that are missing in a list have its neutral values.
std::vector<shared::SensorBeam> beam_table(const RayMeasurementOptions& options) {
    const std::vector<float>& logits = options.actor_logits;
    std::vector<shared::SensorBeam> beams;
    for (std::size_t k = 0; k < std::max(options.beams.size(), logits.size()); ++k) {
        const Beam beam = find_beam(options.beams, k);
        beams.push_back({.range_offset_m = float(beam.range_offset_m),
                         .intensity_gain = float(beam.intensity_gain),
                         .intensity_offset = float(beam.intensity_offset),
                         .actor_logit = k < logits.size() ? logits[k] : 0.0f});
    }
    return beams;
}

std::uint32_t range_kind_number(const std::string& name) {
    if (name == "expected") return RELIDAR_RANGE_EXPECTED;
    if (name == "mode") return RELIDAR_RANGE_MODE;
    return name == "median" ? RELIDAR_RANGE_MEDIAN : RELIDAR_RANGE_NORMALISED;
}

/// Returns the number RELIDAR_DROP_* of an input of the ray-drop network.
/// @throws DataError for an unknown input
std::uint32_t channel_number(const std::string& name) {
    constexpr std::pair<const char*, std::uint32_t> kChannels[] = {
        {"log_range", RELIDAR_DROP_LOG_RANGE}, {"intensity", RELIDAR_DROP_INTENSITY},
        {"drop_logit", RELIDAR_DROP_LOGIT},    {"weight", RELIDAR_DROP_WEIGHT},
        {"spread", RELIDAR_DROP_SPREAD},       {"cosine", RELIDAR_DROP_COSINE},
        {"elevation", RELIDAR_DROP_ELEVATION}};
    for (const auto& [known, channel] : kChannels)
        if (name == known) return channel;
    for (std::uint32_t axis = 0; axis < 3; ++axis)
        if (name == std::string("origin_") + "xyz"[axis]) return RELIDAR_DROP_ORIGIN + axis;
    fail("the ray-drop network needs the unknown input \"{}\"; `relidar refine RUN` trains it again",
         quote(name));
}

}  // namespace

std::vector<std::uint32_t> channel_numbers(const std::vector<std::string>& names) {
    std::vector<std::uint32_t> result;
    for (const std::string& name : names) result.push_back(channel_number(name));
    return result;
}

std::vector<Beam> mean_responses(const RayTable& rays, const std::vector<Beam>& log_beams) {
    constexpr std::size_t kNearBeams = 8;  // so many that a single unusual laser has little effect
    if (log_beams.empty()) return {};
    struct HeightSum {
        double z = 0.0, n = 0.0;  // z components of the directions, number of rays
    };
    std::vector<HeightSum> heights;  // [channels]
    for (std::size_t i = 0; i < rays.size(); ++i) {
        if (rays.channel[i] >= heights.size()) heights.resize(rays.channel[i] + 1u);
        heights[rays.channel[i]].z += double(rays.direction[i].z);
        heights[rays.channel[i]].n += 1.0;
    }
    std::vector<Beam> responses;
    std::vector<Beam> nearest = log_beams;
    for (const HeightSum& height : heights) {
        const double elevation_rad = height.n > 0.0 ? std::asin(height.z / height.n) : 0.0;
        const auto distance_rad = [&](const Beam& beam) {
            return std::pair(std::abs(beam.elevation_rad - elevation_rad), beam.elevation_rad);
        };
        const std::size_t n = std::min(kNearBeams, nearest.size());
        std::ranges::partial_sort(nearest, nearest.begin() + std::ptrdiff_t(n), {}, distance_rad);
        Beam& mean = responses.emplace_back(Beam{.intensity_gain = 0.0});
        for (std::size_t k = 0; k < n; ++k) {
            mean.intensity_gain += nearest[k].intensity_gain / double(n);
            mean.intensity_offset += nearest[k].intensity_offset / double(n);
        }
    }
    return responses;
}

/// Returns the poses of a sensor during a sweep in the format of the kernels, from one
/// pose before the first ray to one after the last ray. Each also has the motion to the
/// next pose, which is zero for the last pose.
/// @param first_s, last_s firing times of the rays, relative to `time_s`
SensorPoses poses_between(const PoseTrack& world_from_sensor, double time_s, double first_s, double last_s) {
    const std::vector<Pose>& pose = world_from_sensor.pose;
    const std::size_t first = world_from_sensor.find_segment(time_s + first_s).left,
                      after_last = world_from_sensor.find_segment(time_s + last_s).left + 1,
                      last = std::min(after_last, pose.size() - 1);
    SensorPoses poses;
    for (std::size_t k = first; k <= last; ++k) {
        const glm::mat3 axes(glm::mat3_cast(pose[k].rotation));
        const glm::vec3 position(pose[k].translation);
        // Motion to the next pose: translation (0 to 2) and rotation vector (3 to 5).
        const Twist next = k < last ? compute_twist(pose[k], pose[k + 1]) : Twist{};
        const double duration_s =
            k < last ? world_from_sensor.time_s[k + 1] - world_from_sensor.time_s[k] : 0.0;
        poses.push_back({.x = axes[0],
                         .y = axes[1],
                         .z = axes[2],
                         .position = position,
                         // the part of the position that single precision loses
                         .position_rest = glm::vec3(pose[k].translation - glm::dvec3(position)),
                         .move_to_next = glm::vec3(next[0], next[1], next[2]),
                         .turn_to_next = glm::vec3(next[3], next[4], next[5]),
                         .time_offset_s = float(world_from_sensor.time_s[k] - time_s),
                         .per_s = duration_s > 0.0 ? float(1.0 / duration_s) : 0.0f});
    }
    return poses;
}

PoseTrack to_frame(PoseTrack track, const Pose& world_from_frame) {
    const Pose frame_from_world = inverse(world_from_frame);
    for (Pose& pose : track.pose) pose = frame_from_world * pose;
    return track;
}

DeviceSensorRays::DeviceSensorRays(Device& device)
    : device_(device),
      fire_(device, "simulate/render/fire_rays"),
      measure_(device, "simulate/render/measure_rays"),
      drop_channels_(device, "simulate/render/drop_channels"),
      no_surfaces_(device, std::span<const shared::RenderedSurface>(std::array{shared::RenderedSurface{}}),
                   "surfaces of no rays") {}

bool DeviceSensorRays::has_rays_of(const RayTable& rays, const std::string& name) const {
    return name == sensor_ && rays.rows == table_.rows && rays.columns == table_.columns &&
           are_bytes_equal(rays.direction, table_.direction) && are_bytes_equal(rays.origin, table_.origin) &&
           are_bytes_equal(rays.time_offset_s, table_.time_offset_s) &&
           are_bytes_equal(rays.channel, table_.channel);
}

void DeviceSensorRays::upload(const RayTable& rays, const std::string& name,
                              const RayFunction& drop_probability) {
    if (has_rays_of(rays, name)) return;
    std::vector<shared::SensorRay> device_rays(rays.size());
    parallel_blocks(device_rays.size(), [&](std::size_t index) {
        device_rays[index] = {.origin = rays.origin[index],
                              .direction = rays.direction[index],
                              .time_offset_s = rays.time_offset_s[index],
                              .sees = 1.0f - drop_probability(index),  // probability of a return
                              .channel = rays.channel[index]};
    });
    if (rays.size() > measured_.size()) {
        // Frees the old arrays before allocating larger ones. If an allocation fails, the
        // table and the last array are empty, so the next call allocates again.
        table_ = {};
        rays_ = {};
        fired_ = {};
        measured_ = {};
        rays_ = Array<shared::SensorRay>(device_, rays.size(), "rays of a sensor");
        fired_ = Array<shared::DeviceRay>(device_, rays.size(), "rays of a sensor in world coordinates");
        measured_ = Array<shared::MeasuredRay>(device_, rays.size(), "measured rays");
        measured_readback_.reset();  // wait_measured() allocates host buffers of the new size
        drops_readback_.reset();
    }
    rays_.upload(device_rays);
    table_ = rays;
    sensor_ = name;
    const auto [first, last] = std::ranges::minmax_element(rays.time_offset_s);
    first_s_ = *first;
    last_s_ = *last;
}

SensorPoses DeviceSensorRays::sweep_poses(const PoseTrack& world_from_sensor, double time_s) const {
    return poses_between(world_from_sensor, time_s, double(first_s_), double(last_s_));
}

void DeviceSensorRays::place(Stream& stream, const PoseTrack& world_from_sensor, double sweep_time_s) {
    const auto poses = this->sweep_poses(world_from_sensor, sweep_time_s);
    run(stream, fire_, table_.size(),
        {.rays = rays_.address(),
         .poses = stream.impl().stage_values(poses),
         .fired = fired_.address(),
         .n_rays = std::uint32_t(table_.size()),
         .n_poses = std::uint32_t(poses.size())});
}

RayBatch DeviceSensorRays::world_batch() const {
    return {.rays = &fired_,
            .n_rays = std::uint32_t(table_.size()),
            .columns = table_.rows > 1 ? std::uint32_t(table_.columns) : 0};
}

void DeviceSensorRays::record_measure(Stream& stream, const RenderedBatch& batch,
                                      const RayMeasurementOptions& options) {
    const std::vector<shared::SensorBeam> beams = beam_table(options);
    // range (x) and factor (y) of each point of the response curve
    std::vector<glm::vec2> response;
    for (std::size_t k = 0; k < options.response.factor.size(); ++k)
        response.emplace_back(options.response.range_m[k], options.response.factor[k]);
    const Array<shared::RenderedSurface>& surfaces = batch.surfaces ? *batch.surfaces : no_surfaces_;
    run(stream, measure_, table_.size(),
        {.rays = rays_.address(),
         .fired = fired_.address(),
         .rendered = batch.rendered->address(),
         .surfaces = surfaces.address(),
         .beams = stream.impl().stage_values(beams),
         .response = stream.impl().stage_values(response),
         .measured = measured_.address(),
         .n_rays = std::uint32_t(table_.size()),
         .n_surfaces = std::uint32_t(surfaces.size()),
         .n_beams = std::uint32_t(beams.size()),
         .n_response = std::uint32_t(response.size()),
         .range_kind = range_kind_number(options.range),
         .min_weight = options.min_weight,
         .min_range_m = float(options.limits.min_m),
         .max_range_m = float(options.limits.max_m)});
    network_drops_ = nullptr;  // those of an earlier scan are no longer valid
}

void DeviceSensorRays::record_drop(Stream& stream, RayDropInference& network, const glm::vec3& sensor_m) {
    const std::vector<std::uint32_t> channels = channel_numbers(network.network().inputs);
    if (channels.size() * table_.size() > samples_.size()) {
        // Pending commands may still use the old array.
        stream.submit_and_wait();
        samples_ = Array<float, shared::DropSamples>(device_, channels.size() * table_.size(),
                                                     "input channels of the ray-drop network");
    }
    run(stream, drop_channels_, table_.size(),
        {.rays = rays_.address(),
         .measured = measured_.address(),
         .channels = stream.impl().stage_values(channels).cast_tag<shared::DropChannels>(),
         .samples = samples_.address(),
         .origin = sensor_m,
         .n_channels = std::uint32_t(channels.size()),
         .n_rays = std::uint32_t(table_.size())});
    // After a full turn, the first column follows the last column.
    const bool is_circular = is_full_turn(table_.rows, table_.columns, table_.direction);
    network_drops_ = &network.record_drops(stream, table_.rows, table_.columns, is_circular, samples_);
}

ScanMeasurements DeviceSensorRays::wait_measured(Stream& stream) {
    const std::size_t n = table_.size();
    const auto record_copy = [&](std::optional<ReadbackBuffer>& target, const Buffer& source,
                                 std::size_t bytes_per_ray, const char* name) {
        // Allocates for all rays that rays_ has space for, also those of larger sensors.
        if (!target) target.emplace(device_, rays_.size() * bytes_per_ray, name);
        target->record_copy(stream, source, n * bytes_per_ray);
    };
    record_copy(measured_readback_, measured_.buffer(), sizeof(shared::MeasuredRay), "measured rays");
    if (network_drops_)
        record_copy(drops_readback_, network_drops_->buffer(), sizeof(float), "drop probabilities");
    stream.submit_commands();
    ScanMeasurements result;
    result.rays = {static_cast<const shared::MeasuredRay*>(measured_readback_->wait_for_bytes(stream)), n};
    if (network_drops_)
        result.network_drops = {static_cast<const float*>(drops_readback_->wait_for_bytes(stream)), n};
    return result;
}

}  // namespace relidar
