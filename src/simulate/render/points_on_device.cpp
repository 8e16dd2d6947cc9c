// SPDX-License-Identifier: Apache-2.0
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

/// Records three kernels: mark the returned rays, compute the index of each point as the
/// number of returned rays before it, and write the points without gaps.
/// @param n_truncated device counter, which is copied to the host with the results
std::shared_ptr<DevicePointComputer::PointReadback> DevicePointComputer::record(
    Stream& stream, const DeviceSensorRays& rays, const PointComputeOptions& options,
    const Array<std::uint32_t>& n_truncated) {
    const std::size_t n = rays.ray_table().size();
    reserve(stream, n);
    const SensorPoses poses = rays.sweep_poses(options.points_from_sensor, options.time_s);
    const std::uint32_t use_image_range = options.is_at_median_range ? 0 : 1;
    run(stream, mark_, n,
        {.measured = rays.device_measured().address(),
         .drop_prob = address_or_null(rays.network_drops()),
         .marks = marks_.address(),
         .n_rays = std::uint32_t(n),
         .has_network = rays.network_drops() ? 1u : 0u,
         .use_image_range = use_image_range,
         .drop_threshold = kDropThreshold});
    sum_.run(stream, {marks_.address_as<std::uint32_t, shared::ScanCounts>()},
             point_indices_.address_as<std::uint32_t, shared::ScanPrefix>(), std::uint32_t(n),
             count_.address());
    run(stream, gather_, n,
        {.rays = rays.device_rays().address(),
         .measured = rays.device_measured().address(),
         .poses = stream.impl().stage_values(poses),
         .marks = marks_.address(),
         .point_index = point_indices_.address(),
         .points = options.target ? options.target->address() : points_.address(),
         .sampled_m = sampled_ranges_.address(),  // written also for rays without a return
         .n_rays = std::uint32_t(n),
         .n_poses = std::uint32_t(poses.size()),
         .n_sampled = std::uint32_t(sample_count(n)),
         .use_image_range = use_image_range});
    return copy_to_host(stream, n, n_truncated, /*has_points=*/!options.target);
}

/// Records copies of the results to host buffers that no pending scan uses.
std::shared_ptr<DevicePointComputer::PointReadback> DevicePointComputer::copy_to_host(
    Stream& stream, std::size_t n_rays, const Array<std::uint32_t>& n_truncated, bool has_points) {
    const auto is_free = [](const auto& one) { return one.use_count() == 1; };  // no pending scan has it
    auto match = std::ranges::find_if(readbacks_, is_free);
    if (match == readbacks_.end()) match = readbacks_.insert(match, std::make_shared<PointReadback>(device_));
    PointReadback& results = **match;
    results.n_rays = n_rays;
    results.has_points = has_points;
    if (has_points) {
        const std::size_t n_bytes = n_rays * sizeof(shared::ReturnedPoint);  // if all rays return
        if (n_rays > results.point_capacity) {
            results.points.emplace(device_, n_bytes, "returned points");
            results.point_capacity = n_rays;
        }
        results.points->record_copy(stream, points_.buffer(), n_bytes);
    }
    results.n_points.record_copy(stream, count_.buffer(), sizeof(std::uint32_t));
    results.sampled_ranges.record_copy(stream, sampled_ranges_.buffer(),
                                       sample_count(n_rays) * sizeof(float));
    results.n_truncated.record_copy(stream, n_truncated.buffer(), sizeof(std::uint32_t));
    return *match;
}

/// Allocates all buffers except `points`, whose size depends on the number of rays.
DevicePointComputer::PointReadback::PointReadback(Device& device)
    : n_points(device, sizeof(std::uint32_t), "number of returned points"),
      sampled_ranges(device, kSampledRays * sizeof(float), "ranges of rays"),
      n_truncated(device, sizeof(std::uint32_t), "number of truncated rays") {}

DevicePointComputer::GatheredPoints DevicePointComputer::wait(Stream& stream, PointReadback& results) {
    const auto read_number = [&](ReadbackBuffer& readback) {
        return *static_cast<const std::uint32_t*>(readback.wait_for_bytes(stream));
    };
    const std::size_t n = read_number(results.n_points);
    std::span<const shared::ReturnedPoint> points;  // stays empty if they were not copied to the host
    if (results.has_points)
        points = {static_cast<const shared::ReturnedPoint*>(results.points->wait_for_bytes(stream)), n};
    const auto* sampled_m = static_cast<const float*>(results.sampled_ranges.wait_for_bytes(stream));
    return {.n_points = n,
            .points = points,
            .sampled_m = {sampled_m, sample_count(results.n_rays)},
            .n_truncated = read_number(results.n_truncated)};
}

}  // namespace relidar
