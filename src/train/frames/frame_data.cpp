// SPDX-License-Identifier: Apache-2.0
#include "train/frames/frame_data.hpp"

#include <algorithm>
#include <cstddef>

#include <relidar/run/run.hpp>
#include <relidar/scene/device_scene.hpp>
#include <relidar/scene/labels.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/train/train.hpp>

#include "base/geometry/ray_box.hpp"
#include "base/parallel.hpp"
#include "train/frames/sensor_drop.hpp"

namespace relidar {
namespace {

struct MovingBoxMask {
    InstancePose placed;
    glm::dvec3 half_size_m;
    double reach_m;  ///< radius of a sphere that contains the box during the full sweep
};

/// Returns the moving boxes without a model that are present in a sweep, with a margin
/// because labels do not fit exactly.
std::vector<MovingBoxMask> list_masked_boxes(const Log& log, const SweepTiming& sweep,
                                             const IgnoredMeasurements& rules) {
    std::vector<MovingBoxMask> result;
    for (const BoxTrack& box : list_foreground(log, rules.moving)) {
        const bool is_actor =
            std::find(rules.actors.begin(), rules.actors.end(), box.id) != rules.actors.end();
        if (is_actor || !box.is_observed(sweep.time_s)) continue;
        const glm::dvec3 half_size_m = 0.5 * box.size_m + kMoverMargin_m;
        const InstancePose placed = box_pose_in_sweep(log, box.world_from_box, half_size_m, sweep);
        const double driven_length_m = glm::length(placed.motion.velocity_mps) * placed.motion.half_span_s;
        result.push_back({placed, half_size_m, glm::length(half_size_m) + driven_length_m});
    }
    return result;
}

/// Returns true if training must ignore a ray: it hit a moving box, or it has no return
/// and may have hit one.
/// @param time_offset_s  firing time relative to the reference time of the sweep
bool is_ray_masked(const std::vector<MovingBoxMask>& masked_boxes, const WorldRay& ray, double time_offset_s,
                   double range_m) {
    return std::ranges::any_of(masked_boxes, [&](const MovingBoxMask& box) {
        const InstancePose& placed = box.placed;
        // A fast test with a sphere around the box rejects most rays.
        if (!passes_sphere(ray.origin_m, ray.direction, placed.world_from_model.translation, box.reach_m))
            return false;
        const Pose world_from_box = placed.motion.pose_at(placed.world_from_model, time_offset_s);
        // Distances along the ray. If it misses the box, the first is larger.
        const glm::dvec2 enter_leave_m = PosedBox{inverse(world_from_box), box.half_size_m}.intersect_m(ray);
        const bool crosses_box = enter_leave_m.x <= enter_leave_m.y;
        const bool returns_from_box = range_m >= enter_leave_m.x && range_m <= enter_leave_m.y;
        const bool has_return = range_m > 0.0;
        return crosses_box && (returns_from_box || !has_return);
    });
}

}  // namespace

glm::dvec2 PosedBox::intersect_m(const WorldRay& ray, double margin_m) const {
    const glm::dvec3 o = box_from_world * ray.origin_m, d = box_from_world.rotation * ray.direction,
                     half_m = half_size_m + margin_m;
    const auto inside = cross_box(o, d, -half_m, half_m);
    return inside ? glm::dvec2(std::max(inside->enter, 0.0), inside->leave) : glm::dvec2(1.0, 0.0);
}

void make_frame_arrays(const Log& log, const Frame& frame, const IgnoredMeasurements& mask_rules,
                       std::vector<DeviceRay>& rays, std::vector<DeviceTarget>& targets) {
    const Scan& scan = frame.scan;
    const std::vector<MovingBoxMask> boxes = list_masked_boxes(log, timing_of(frame), mask_rules);
    const PoseTrack track = log.lidar_track(frame.lidar);
    const BodyTable& own_body = log.lidar_of(frame).own_body;
    rays.resize(scan.range_m.size());
    targets.resize(scan.range_m.size());
    parallel_blocks(scan.range_m.size(), [&](std::size_t index) {
        const WorldRay ray = make_world_ray(track, frame.time_s, scan.rays, index, log.rolling_shutter);
        const float time_offset_s = log.rolling_shutter ? scan.rays.time_offset_s[index] : 0.0f;
        rays[index] = {glm::vec3(ray.origin_m), glm::vec3(ray.direction), time_offset_s};
        // A blind ray: its beam is nearly always dropped at this azimuth.
        const bool is_ignored = is_blind_ray(mask_rules.observed_drops, log, frame, index) ||
                                own_body.hides(scan.rays.direction[index], scan.range_m[index]) ||
                                is_ray_masked(boxes, ray, double(time_offset_s), scan.range_m[index]);
        const SurfaceReturn surface = surface_return(log, frame, index);
        targets[index] = {
            .range_m = surface.range_m, .intensity = surface.intensity, .weight = is_ignored ? 0.0f : 1.0f};
    });
}

std::uint32_t max_frame_rays(std::span<const TrainingFrameData> frames) {
    std::uint32_t most = 0;
    for (const TrainingFrameData& frame : frames) most = std::max(most, frame.n_rays);
    return most;
}

/// Returns a batch with every stride-th ray of the frame.
RayBatch TrainingFrameData::strided_batch(std::uint32_t first_ray, std::uint32_t stride) const {
    // If the stride divides the number of columns, the rays are columns of the image.
    const bool is_column_subset = image.columns % stride == 0 && first_ray < stride;
    return {.rays = &device_rays(),
            .first = first_ray,
            .stride = stride,
            .n_rays = (n_rays - first_ray + stride - 1) / stride,
            .columns = is_column_subset ? image.columns / stride : 0,
            .targets = &loss_targets()};
}

SimulatedSensor nominal_sensor(const Config& config, const Log& log, const Frame& frame) {
    SimulatedSensor sensor = choose_sensor("native", config, log, frame.lidar);
    if (sensor.rays.rows != frame.scan.rays.rows || sensor.rays.columns != frame.scan.rays.columns) {
        sensor.rays = frame.scan.rays;
        sensor.follows_sweeps = false;
    }
    sensor.rolling_shutter = log.rolling_shutter;  // same setting as in the measured scan
    return sensor;
}

IgnoredMeasurements mask_movers(const Config& config, const Scene& scene) {
    return {config.init, actor_names(scene), {}};
}

TrainingRays make_training_rays(const Run& run, const Frame& frame) {
    TrainingRays made;
    make_frame_arrays(run.log, frame, mask_movers(run.config, run.scene), made.rays, made.targets);
    return made;
}

std::vector<float> classify_drops(const Log& log, const Frame& frame, const IgnoredMeasurements& rules) {
    std::vector<DeviceRay> rays;
    std::vector<DeviceTarget> targets;
    make_frame_arrays(log, frame, rules, rays, targets);  // gives ignored rays the weight 0
    std::vector<float> dropped;
    for (std::size_t ray = 0; ray < targets.size(); ++ray) {
        const bool is_ignored = !(targets[ray].weight > 0.0f);
        const bool has_return = frame.scan.range_m[ray] > 0.0f;
        if (is_ignored) dropped.push_back(-1.0f);
        else dropped.push_back(has_return ? 0.0f : 1.0f);
    }
    return dropped;
}

std::vector<int> select_evenly(const std::vector<int>& frames, int max_count) {
    if (max_count <= 0 || frames.size() <= std::size_t(max_count)) return frames;
    std::vector<int> chosen;
    for (std::size_t i = 0; i < std::size_t(max_count); ++i)
        chosen.push_back(frames[i * frames.size() / std::size_t(max_count)]);
    return chosen;
}

}  // namespace relidar
