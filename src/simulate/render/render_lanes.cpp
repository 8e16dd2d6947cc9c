// SPDX-License-Identifier: Apache-2.0
#include "simulate/render/render_lanes.hpp"

#include <fmt/format.h>

#include <relidar/gpu/out_of_memory.hpp>

namespace relidar {

RenderLanes::RenderLanes(Device& device, ResidentScene& scene)
    : device_(device), scene_(scene), limit_(ScanRenderer::default_parallel(device)) {
    lanes_.emplace_back(device, scene);
}

/// Adds lanes with copies of the scene up to the limit, and opens a batch on them. If the
/// memory of the device is too small, lowers the limit to the lanes that fit.
void RenderLanes::begin_batch() {
    while (std::ssize(lanes_) < limit_) {
        try {
            lanes_.emplace_back(device_, scene_, scene_.copy_renderer(), drop_network());
        } catch (const OutOfDeviceMemory&) {
            limit_ = int(lanes_.size());
        }
    }
    batch_.emplace(scene_.renderer().stream(), lanes_.size());
    n_batch_ = 0;
}

RenderLane& RenderLanes::choose_lane(ScanRenderer::SubmissionTiming timing) {
    if (!batch_) {  // the last batch was submitted
        if (timing == ScanRenderer::SubmissionTiming::now || parallel_limit() == 1) return first();
        begin_batch();
    }
    // The scans of a batch use the lanes in turn.
    const std::size_t lane = n_batch_++ % lanes_.size();
    batch_->select_lane(lane);  // the next commands are recorded for this lane
    return lanes_[lane];
}

void RenderLanes::submit(ScanRenderer::SubmissionTiming timing) {
    if (batch_ && timing == ScanRenderer::SubmissionTiming::with_next) return;
    batch_.reset();
    scene_.renderer().stream().submit_commands();
}

void RenderLanes::submit_batch() {
    if (batch_) submit(ScanRenderer::SubmissionTiming::now);
}

void RenderLanes::use_network(const RayDropNetwork& network) {
    remove_copies();  // the next batch adds lanes with this network
    first().refiner.reset();
    if (!network.empty()) first().refiner.emplace(device_, network);
}

void RenderLanes::change_copies(const std::function<void(Renderer&)>& change) {
    try {
        for (std::size_t i = 1; i < lanes_.size(); ++i) change(lanes_[i].renderer());
    } catch (const OutOfDeviceMemory&) {
        remove_copies();
    }
}

void RenderLanes::set_limit(int count) {
    limit_ = count;
    keep_lanes(std::size_t(count));
}

void RenderLanes::keep_lanes(std::size_t count) {
    while (lanes_.size() > count) lanes_.pop_back();
}

std::shared_ptr<DeviceSensorRays> RenderLane::upload_rays(const SimulatedSensor& sensor,
                                                          const RayTable& ray_table,
                                                          const RayFunction& drop_probability) {
    const std::string name = fmt::format("{}, LiDAR {}, {}", sensor.name, sensor.lidar, sensor.is_log_lidar);
    // An entry can be overwritten if no pending scan shares its ownership, and if it is
    // empty or belongs to the same sensor.
    const auto is_free = [&](const std::shared_ptr<DeviceSensorRays>& rays) {
        return rays.use_count() == 1 && (rays->ray_table().size() == 0 || rays->sensor_name() == name);
    };
    auto entry =
        std::ranges::find_if(cached_, [&](const auto& rays) { return rays->has_rays_of(ray_table, name); });
    const bool is_uploaded = entry != cached_.end();
    if (!is_uploaded) entry = std::ranges::find_if(cached_, is_free);
    if (entry == cached_.end()) entry = cached_.insert(entry, std::make_shared<DeviceSensorRays>(device_));
    std::rotate(cached_.begin(), entry, entry + 1);  // moves the entry to the front
    const std::shared_ptr<DeviceSensorRays> rays = cached_.front();
    if (!is_uploaded) rays->upload(ray_table, name, drop_probability);
    trim_cache();
    return rays;
}

/// Keeps the most recently used entries that fit the limits, at least the first.
void RenderLane::trim_cache() {
    // Limits for the rays of all entries, which need at most 0.2 GB of device memory.
    constexpr std::size_t kMostSensors = 8, kMostRays = std::size_t(1) << 21;
    std::size_t n_rays = 0, n_kept = 0;
    for (const auto& cached : cached_) {
        n_rays += cached->ray_table().size();
        if (n_rays > kMostRays || n_kept == kMostSensors) break;
        ++n_kept;
    }
    cached_.resize(std::max<std::size_t>(n_kept, 1));
}

}  // namespace relidar
