// SPDX-License-Identifier: Apache-2.0
// Runs two kernels: simulate/render/mark_returns selects the returned rays, and
// simulate/render/gather_points computes their points.
#include "simulate/render/points_on_device.hpp"

#include <relidar/log/range_image.hpp>

#include "simulate/render/sensor_rays.hpp"

namespace relidar {

DevicePointComputer::DevicePointComputer(Device& device)
    : device_(device),
      mark_(device, "simulate/render/mark_returns"),
      gather_(device, "simulate/render/gather_points"),
      sum_(device),
      count_(device, 1, "number of returned points"),
      sampled_ranges_(device, kSampledRays, "ranges of rays") {}

void DevicePointComputer::reserve(Stream& stream, std::size_t n_rays) {
    if (n_rays <= points_.size()) return;
    // Pending commands may still use the old arrays.
    stream.submit_and_wait();
    marks_ = {};
    point_indices_ = {};
    points_ = {};  // frees the old arrays before allocating larger ones
    marks_ = Array<std::uint32_t, shared::ReturnMarks>(device_, n_rays, "rays with a return");
    point_indices_ = Array<std::uint32_t, shared::ReturnPlaces>(device_, n_rays, "indices of points");
    sum_.reserve_scratch(device_, n_rays);
    points_ = Array<shared::ReturnedPoint>(device_, n_rays, "returned points");
}

/// Records three kernels: mark the returned rays, compute the index of each point by a
/// prefix sum, and gather the points without gaps.
std::shared_ptr<DevicePointComputer::PointReadbackSlot> DevicePointComputer::record(
    Stream& stream, const DeviceSensorRays& rays, const PointComputeOptions& options,
    const Array<std::uint32_t>& truncated) {
    const std::size_t n = rays.ray_table().size();
    reserve(stream, n);
    const std::vector<shared::SensorPose> poses =
        rays.sweep_poses(options.points_from_sensor, options.time_s);
    run(stream, mark_, n,
        {.measured = rays.device_measured().address(),
         .drop_prob = rays.drop_address(),
         .marks = marks_.address(),
         .n_rays = std::uint32_t(n),
         .refined = options.refined ? 1u : 0u,
         .of_image = options.of_image ? 1u : 0u,
         .drop_threshold = kDropThreshold});
    sum_.run(stream, {marks_.address_as<std::uint32_t, shared::ScanCounts>()},
             point_indices_.address_as<std::uint32_t, shared::ScanPrefix>(), std::uint32_t(n),
             count_.address());
    run(stream, gather_, n,
        {.rays = rays.device_rays().address(),
         .measured = rays.device_measured().address(),
         .poses = stream.impl().stage_values(poses),
         .marks = marks_.address(),
         .places = point_indices_.address(),
         .points = options.target ? options.target->address() : points_.address(),
         .asked = sampled_ranges_.address(),  // ranges of the sampled rays
         .n_rays = std::uint32_t(n),
         .n_poses = std::uint32_t(poses.size()),
         .n_requested = std::uint32_t(sample_count(n)),
         .of_image = options.of_image ? 1u : 0u});
    return record_readback(stream, n, truncated, options.target != nullptr);
}

// The buffer of points is allocated by record_readback(), which knows its size.
DevicePointComputer::PointReadbackSlot::PointReadbackSlot(Device& device)
    : count(device, sizeof(std::uint32_t), "number of returned points"),
      sampled_ranges(device, kSampledRays * sizeof(float), "ranges of rays"),
      capped(device, sizeof(std::uint32_t), "number of truncated rays") {}

/// Records the copies of the results of a scan to host buffers, which stay in use until
/// the caller releases them.
/// @param on_device if true, the points stay on the device
std::shared_ptr<DevicePointComputer::PointReadbackSlot> DevicePointComputer::record_readback(
    Stream& stream, std::size_t n_rays, const Array<std::uint32_t>& truncated, bool on_device) {
    // A slot is free if no pending scan refers to it.
    auto free_slot = std::ranges::find_if(
        slots_, [](const std::shared_ptr<PointReadbackSlot>& slot) { return slot.use_count() == 1; });
    if (free_slot == slots_.end())
        free_slot = slots_.insert(free_slot, std::make_shared<PointReadbackSlot>(device_));
    PointReadbackSlot& slot = **free_slot;
    slot.on_device = on_device;
    slot.n_rays = n_rays;
    if (!on_device) {
        const std::size_t n_bytes = n_rays * sizeof(shared::ReturnedPoint);  // if all rays return
        if (n_rays > slot.point_capacity) {
            slot.points.emplace(device_, n_bytes, "returned points");
            slot.point_capacity = n_rays;
        }
        slot.points->record_copy(stream, points_.buffer(), n_bytes);
    }
    slot.count.record_copy(stream, count_.buffer(), sizeof(std::uint32_t));
    slot.sampled_ranges.record_copy(stream, sampled_ranges_.buffer(), sample_count(n_rays) * sizeof(float));
    slot.capped.record_copy(stream, truncated.buffer(), sizeof(std::uint32_t));
    return *free_slot;
}

DevicePointComputer::GatheredPoints DevicePointComputer::wait(Stream& stream, PointReadbackSlot& buffers) {
    const auto read_number = [&](ReadbackBuffer& readback) {
        return *static_cast<const std::uint32_t*>(readback.wait_for_bytes(stream));
    };
    const std::size_t n = read_number(buffers.count);
    std::span<const shared::ReturnedPoint> points;
    if (!buffers.on_device)
        points = {static_cast<const shared::ReturnedPoint*>(buffers.points->wait_for_bytes(stream)), n};
    const auto* sampled_m = static_cast<const float*>(buffers.sampled_ranges.wait_for_bytes(stream));
    return {.n_points = n,
            .points = points,
            .sampled_m = {sampled_m, sample_count(buffers.n_rays)},
            .n_capped = read_number(buffers.capped)};
}

}  // namespace relidar
