// SPDX-License-Identifier: Apache-2.0
#include "simulate/render/render_lanes.hpp"

#include <algorithm>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/gpu/out_of_memory.hpp>

#include "simulate/render/resident_scene.hpp"

namespace relidar {

RenderLanes::RenderLanes(Device& device, ResidentScene& scene)
    : device_(device), scene_(scene), first_(device), most_(ScanRenderer::choose_max_lanes(device)) {}

RenderLane& RenderLanes::next() {
    if (!batch_) {
        while (1 + std::ssize(others_) < most_) {
            const std::size_t n_before = others_.size();
            try {
                others_.emplace_back(device_).copy = scene_.copy();
                // If device memory is exhausted, continues with the copies that exist.
            } catch (const OutOfDeviceMemory&) {
                if (others_.size() > n_before) others_.pop_back();
                most_ = 1 + int(others_.size());
            }
        }
        batch_.emplace(scene_.renderer().stream(), 1 + others_.size());
        n_batch_ = 0;
    }
    const std::size_t lane = n_batch_++ % (1 + others_.size());
    batch_->select_lane(lane);
    return lane == 0 ? first_ : others_[lane - 1];
}

void RenderLanes::submit_batch() {
    if (!batch_) return;
    batch_.reset();
    scene_.renderer().stream().submit();
}

Renderer& RenderLanes::renderer(const RenderLane& lane) { return lane.copy ? *lane.copy : scene_.renderer(); }

void RenderLanes::set_network(const DropNetwork& network) {
    first_.refiner.reset();
    for (RenderLane& lane : others_) lane.refiner.reset();
    if (!network.empty()) first_.refiner.emplace(device_, network);
}

DropRefiner& RenderLanes::refiner(RenderLane& lane) {
    if (!lane.refiner) lane.refiner.emplace(device_, first_.refiner->network());
    return *lane.refiner;
}

void RenderLanes::set_max_lanes(int count) {
    most_ = count;
    while (std::ssize(others_) >= count) others_.pop_back();
}

std::shared_ptr<SensorRays> RenderLane::upload(Device& device, const SensorChoice& sensor,
                                               const RayTable& table,
                                               const std::function<float(std::size_t)>& never_seen) {
    // limits for the rays that stay in device memory, where they need 0.2 GB
    constexpr std::size_t kMostSensors = 8, kMostRays = std::size_t(1) << 21;
    const std::string name = fmt::format("{}, LiDAR {}, {}", sensor.name, sensor.lidar, sensor.is_own);
    const auto known =
        std::ranges::find_if(known_rays, [&](const auto& rays) { return rays->has(table, name); });
    if (known != known_rays.end()) {
        std::rotate(known_rays.begin(), known, known + 1);
        return known_rays.front();
    }
    // Returns true if an entry can be overwritten: no pending scan uses its rays, and it
    // is empty or belongs to the same sensor.
    const auto is_free = [&](const std::shared_ptr<SensorRays>& rays) {
        return rays.use_count() == 1 && (rays->table().size() == 0 || rays->sensor() == name);
    };
    // Overwrites the entry of the same sensor, whose rays may differ from scan to scan.
    auto place = std::ranges::find_if(known_rays, is_free);
    if (place == known_rays.end()) place = known_rays.insert(place, std::make_shared<SensorRays>(device));
    std::rotate(known_rays.begin(), place, place + 1);
    const std::shared_ptr<SensorRays> rays = known_rays.front();
    rays->take(table, name, never_seen);
    std::size_t n_rays = 0, n_kept = 0;
    for (const auto& kept : known_rays)
        if ((n_rays += kept->table().size()) <= kMostRays && n_kept < kMostSensors) ++n_kept;
    known_rays.resize(std::max<std::size_t>(n_kept, 1));
    return rays;
}

}  // namespace relidar
