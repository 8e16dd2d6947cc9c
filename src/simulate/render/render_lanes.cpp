// SPDX-License-Identifier: Apache-2.0
#include "simulate/render/render_lanes.hpp"

#include <fmt/format.h>

#include <relidar/gpu/out_of_memory.hpp>

#include "simulate/render/resident_scene.hpp"

namespace relidar {

ParallelScanResourcePool::ParallelScanResourcePool(Device& device, ResidentScene& scene)
    : device_(device), scene_(scene), first_(device), most_(ScanRenderer::default_parallel(device)) {}

ParallelScanResources& ParallelScanResourcePool::next_lane() {
    if (!batch_) {
        // A lane has the buffers of one scan. Adds lanes with copies of the scene up to
        // most_, which falls to the number that the device memory can hold.
        while (1 + std::ssize(others_) < most_) {
            const std::size_t n_before = others_.size();
            try {
                others_.emplace_back(device_).copy = scene_.copy_renderer();
            } catch (const OutOfDeviceMemory&) {
                if (others_.size() > n_before) others_.pop_back();  // a lane without its copy
                most_ = 1 + int(others_.size());
            }
        }
        batch_.emplace(scene_.renderer().stream(), 1 + others_.size());
        n_batch_ = 0;
    }
    // The scans use the lanes in turn. Lane 0 has the scene itself, others have copies.
    const std::size_t lane = n_batch_++ % (1 + others_.size());
    batch_->select_lane(lane);
    return lane == 0 ? first_ : others_[lane - 1];
}

void ParallelScanResourcePool::submit_batch() {
    if (!batch_) return;
    batch_.reset();
    scene_.renderer().stream().submit_commands();
}

Renderer& ParallelScanResourcePool::renderer_of(const ParallelScanResources& lane) {
    return lane.copy ? *lane.copy : scene_.renderer();
}

void ParallelScanResourcePool::use_network(const RayDropNetwork& network) {
    first_.refiner.reset();
    for (ParallelScanResources& lane : others_) lane.refiner.reset();
    if (!network.empty()) first_.refiner.emplace(device_, network);
}

RayDropRefiner& ParallelScanResourcePool::refiner_of(ParallelScanResources& lane) {
    if (!lane.refiner) lane.refiner.emplace(device_, first_.refiner->network());
    return *lane.refiner;
}

void ParallelScanResourcePool::change_copies(const std::function<void(Renderer&)>& change) {
    try {
        for (const ParallelScanResources& lane : others_) change(*lane.copy);
    } catch (const OutOfDeviceMemory&) {
        remove_copies();
    }
}

void ParallelScanResourcePool::set_limit(int count) {
    most_ = count;
    while (std::ssize(others_) >= count) others_.pop_back();
}

/// Returns the rays of a sensor on the device, and uploads them unless they are cached.
/// The cache is sorted by last use, so that the oldest entries are dropped.
std::shared_ptr<DeviceSensorRays> ParallelScanResources::upload_rays(Device& device,
                                                                     const SimulatedSensor& sensor,
                                                                     const RayTable& ray_table,
                                                                     const RayFunction& drop_probability) {
    // Limits for the rays of all entries, which need at most 0.2 GB of device memory.
    constexpr std::size_t kMostSensors = 8, kMostRays = std::size_t(1) << 21;
    const std::string name = fmt::format("{}, LiDAR {}, {}", sensor.name, sensor.lidar, sensor.is_log_lidar);
    const auto match =
        std::ranges::find_if(cached, [&](const auto& rays) { return rays->is_uploaded(ray_table, name); });
    if (match != cached.end()) {
        std::rotate(cached.begin(), match, match + 1);  // moves the match to the front
        return cached.front();
    }
    // An entry can be overwritten if no pending scan uses its rays, and if it is empty or
    // belongs to the same sensor.
    const auto is_free = [&](const std::shared_ptr<DeviceSensorRays>& rays) {
        return rays.use_count() == 1 && (rays->ray_table().size() == 0 || rays->sensor_name() == name);
    };
    auto free_entry = std::ranges::find_if(cached, is_free);
    if (free_entry == cached.end())
        free_entry = cached.insert(free_entry, std::make_shared<DeviceSensorRays>(device));
    std::rotate(cached.begin(), free_entry, free_entry + 1);
    const std::shared_ptr<DeviceSensorRays> rays = cached.front();
    rays->upload(ray_table, name, drop_probability);
    // Keeps the most recently used entries that fit the limits, at least the first.
    std::size_t n_rays = 0, n_kept = 0;
    for (const auto& entry : cached) {
        n_rays += entry->ray_table().size();
        if (n_rays > kMostRays || n_kept == kMostSensors) break;
        ++n_kept;
    }
    cached.resize(std::max<std::size_t>(n_kept, 1));
    return rays;
}

}  // namespace relidar
