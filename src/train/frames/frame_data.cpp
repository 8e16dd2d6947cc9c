// SPDX-License-Identifier: Apache-2.0
// Training rays and targets from scans.
#include "train/frames/frame_data.hpp"

#include <algorithm>

#include "core/parallel.hpp"
#include "train/poses/placed_box.hpp"
#include "train/drops/sensor_drop.hpp"

namespace relidar {

namespace {

/// Moving boxes where they are now, grown by the margin.
std::vector<PlacedBox> masked_boxes_at(const Sequence& sequence, double t_s, const Unknown& masks) {
    std::vector<PlacedBox> placed;
    for (const BoxTrack& box : separate_boxes(sequence, masks.moving)) {
        const bool is_actor = std::find(masks.actors.begin(), masks.actors.end(), box.id) != masks.actors.end();
        if (is_actor || !box.present(t_s)) continue;
        placed.push_back({inverse(box.world_from_box.at(t_s)), 0.5 * box.size_m + kMoverMargin_m});
    }
    return placed;
}

bool is_unknown(const std::vector<PlacedBox>& boxes, const WorldRay& ray, double range_m) {
    return std::any_of(boxes.begin(), boxes.end(), [&](const PlacedBox& box) {
        const glm::dvec2 inside = box.interval(ray);
        return inside.x <= inside.y && (range_m <= 0.0 || (range_m >= inside.x && range_m <= inside.y));
    });
}

}  // namespace

void make_targets(const Sequence& sequence, const Frame& frame, const Unknown& masks, std::vector<DeviceRay>& rays,
                  std::vector<DeviceTarget>& targets) {
    const Scan& scan = frame.scan;
    const std::vector<PlacedBox> boxes = masked_boxes_at(sequence, frame.time_s, masks);   // moved less than the margin within a sweep
    const PoseTrack track = sequence.world_from_sensor(frame.lidar);
    rays.resize(scan.range_m.size());
    targets.resize(scan.range_m.size());
    for_each_block(scan.range_m.size(), [&](std::size_t i) {
        const WorldRay w = world_ray(track, frame.time_s, scan.rays, i, sequence.rolling_shutter);
        const bool unknown = is_blind(masks.observed_drops, sequence, frame, i) || is_unknown(boxes, w, scan.range_m[i]);
        rays[i] = {glm::vec3(w.origin_m), glm::vec3(w.direction)};
        const SurfaceReturn surface = surface_return(sequence, frame, i);
        targets[i] = {surface.range_m, surface.intensity, unknown ? 0.0f : 1.0f};
    });
}

std::uint32_t most_rays(std::span<const FrameData> frames) {
    std::uint32_t most = 0;
    for (const FrameData& frame : frames) most = std::max(most, frame.n_rays);
    return most;
}

RayBatch FrameData::batch(std::uint32_t first, std::uint32_t stride) const {
    const bool whole = image.columns % stride == 0 && first < stride;   // every stride-th column of each row
    return {&rays(), first, stride, (n_rays - first + stride - 1) / stride, whole ? image.columns / stride : 0, &targets()};
}

}  // namespace relidar
