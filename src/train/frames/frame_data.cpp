// SPDX-License-Identifier: Apache-2.0
// Computes the training rays and their target values (range, intensity, weight) from
// scans.
#include "train/frames/frame_data.hpp"

#include <algorithm>

#include <relidar/scene/device_scene.hpp>

#include "base/parallel.hpp"
#include "train/drops/sensor_drop.hpp"
#include "train/poses/placed_box.hpp"

namespace relidar {

namespace {

/// A moving box without a model, enlarged by a margin. Training ignores the returns
/// inside it.
struct MaskedBox {
    InstancePose placed;
    glm::dvec3 half_size_m;
    /// radius of a sphere around the box centre; the sphere contains the box during the
    /// full sweep
    double reach_m;

    bool can_intersect(const WorldRay& ray) const {
        const glm::dvec3 to_centre = placed.world_from_model.translation - ray.origin_m;
        const double along_m = std::max(glm::dot(to_centre, ray.direction), 0.0);
        return glm::distance(to_centre, along_m * ray.direction) <= reach_m;
    }
    PlacedBox at(double after_s) const {
        return {inverse(placed.motion.at(placed.world_from_model, after_s)), half_size_m};
    }
};

std::vector<MaskedBox> list_masked_boxes_in_sweep(const Sequence& sequence, const SweepMoment& sweep,
                                                  const Unknown& masks) {
    std::vector<MaskedBox> result;
    for (const BoxTrack& box : list_foreground_boxes(sequence, masks.moving)) {
        const bool is_actor =
            std::find(masks.actors.begin(), masks.actors.end(), box.id) != masks.actors.end();
        if (is_actor || !box.is_present(sweep.time_s)) continue;
        const glm::dvec3 half_size_m = 0.5 * box.size_m + kMoverMargin_m;
        const InstancePose placed = compute_pose_in_sweep(sequence, box.world_from_box, half_size_m, sweep);
        const double driven_length_m = glm::length(placed.motion.velocity_mps) * placed.motion.half_span_s;
        result.push_back({placed, half_size_m, glm::length(half_size_m) + driven_length_m});
    }
    return result;
}

/// Returns true if a ray hit a moving box, or may have hit it and has no return. Training
/// ignores such a ray.
/// @param after_s  firing time of the ray, relative to the reference time of the sweep
bool is_unknown(const std::vector<MaskedBox>& boxes, const WorldRay& ray, double after_s, double range_m) {
    return std::any_of(boxes.begin(), boxes.end(), [&](const MaskedBox& box) {
        if (!box.can_intersect(ray)) return false;
        const glm::dvec2 inside = box.at(after_s).compute_ray_interval(ray);
        return inside.x <= inside.y && (range_m <= 0.0 || (range_m >= inside.x && range_m <= inside.y));
    });
}

}  // namespace

void make_targets(const Sequence& sequence, const Frame& frame, const Unknown& masks,
                  std::vector<DeviceRay>& rays, std::vector<DeviceTarget>& targets) {
    const Scan& scan = frame.scan;
    const std::vector<MaskedBox> boxes = list_masked_boxes_in_sweep(sequence, get_sweep_moment(frame), masks);
    const PoseTrack track = sequence.world_from_sensor(frame.lidar);
    rays.resize(scan.range_m.size());
    targets.resize(scan.range_m.size());
    for_each_block(scan.range_m.size(), [&](std::size_t index) {
        const WorldRay w = make_world_ray(track, frame.time_s, scan.rays, index, sequence.rolling_shutter);
        const float after_s = sequence.rolling_shutter ? scan.rays.time_offset_s[index] : 0.0f;
        const bool unknown = is_blind(masks.observed_drops, sequence, frame, index) ||
                             is_unknown(boxes, w, double(after_s), scan.range_m[index]);
        rays[index] = {glm::vec3(w.origin_m), glm::vec3(w.direction), after_s};
        const SurfaceReturn surface = compute_surface_return(sequence, frame, index);
        targets[index] = {surface.range_m, surface.intensity, unknown ? 0.0f : 1.0f};
    });
}

std::uint32_t find_max_rays(std::span<const FrameData> frames) {
    std::uint32_t most = 0;
    for (const FrameData& frame : frames) most = std::max(most, frame.n_rays);
    return most;
}

RayBatch FrameData::batch(std::uint32_t first, std::uint32_t stride) const {
    // True if the rays form complete columns of the image. This requires that the stride
    // divides the number of columns.
    const bool is_column_subset = image.columns % stride == 0 && first < stride;
    return {&rays(),
            first,
            stride,
            (n_rays - first + stride - 1) / stride,
            is_column_subset ? image.columns / stride : 0,
            &targets()};
}

}  // namespace relidar
