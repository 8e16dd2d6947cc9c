// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include <relidar/diff/loss.hpp>
#include <relidar/diff/traversal.hpp>
#include <relidar/gpu/stream.hpp>
#include <relidar/log/log.hpp>
#include <relidar/run/config.hpp>
#include <relidar/scene/scene.hpp>

#include "train/shared/train.h"

namespace relidar {

struct SimulatedSensor;

struct PosedBox {
    Pose box_from_world;
    glm::dvec3 half_size_m;

    /// Distances at which a ray enters and leaves the box, at least 0, by the slab
    /// method. Entry > exit if the ray misses it.
    /// @param margin_m  enlarges the box on every side
    glm::dvec2 intersect_m(const WorldRay& ray, double margin_m = 0.0) const;
};

/// Device arrays with the rays of a frame. They can be longer than the frame, because
/// frames of different lengths use the same arrays.
struct FrameArrays {
    Array<DeviceRay> rays;        ///< [n] rays, computed from the poses at the start of training
    Array<DeviceTarget> targets;  ///< [n] measurements
    /// [n] Pose before the firing time, counted from TrainingFrameData::first_knot, and
    /// fraction of the time to the next pose. Empty if poses are not corrected.
    Array<shared::PoseInterpolation> track_positions;
};

struct TrainingFrameData {
    int position = 0;  ///< index into Log::frames
    int index = 0;     ///< frame number of the dataset
    std::uint32_t n_rays = 0;
    ImageShape image;
    /// index of the first vehicle pose ("knot" of the track) that the rays need
    std::size_t first_knot = 0;
    std::uint32_t n_knots = 0;                  ///< number of vehicle poses that the rays need
    std::shared_ptr<const FrameArrays> arrays;  ///< arrays with the rays while the frame is on the device
    /// [n] rays from corrected sensor poses; null if poses are not corrected
    const Array<DeviceRay>* moved_rays = nullptr;
    /// number of rays with a return, without ignored rays; set by the first upload
    double n_returned = 0.0;
    double n_known_rays = 0.0;
    std::vector<InstancePose> placed;   ///< poses of all instances of the scene
    glm::vec3 sensor_position_m{0.0f};  ///< sensor position at the reference time, world frame

    const Array<DeviceRay>& device_rays() const { return moved_rays ? *moved_rays : arrays->rays; }
    const Array<DeviceTarget>& loss_targets() const { return arrays->targets; }
    RayBatch strided_batch(std::uint32_t first_ray, std::uint32_t stride) const;
};

std::uint32_t max_frame_rays(std::span<const TrainingFrameData> frames);

struct IgnoredMeasurements {
    /// settings that decide which moving boxes become actors, are ignored, or belong to
    /// the background
    InitOptions moving;
    /// tracks of the actors that have a model in the scene; training uses the returns on
    /// these actors
    std::vector<std::string> actors;
    /// Training ignores rays of a beam at azimuths at which at least 95 % of them drop.
    RayDropTable observed_drops;
};

/// Computes the rays of a frame in the world, and their measurements. Rays that the
/// background must not learn get weight 0: returns from inside a moving box, and dropped
/// rays that may have hit such a box.
void make_frame_arrays(const Log& log, const Frame& frame, const IgnoredMeasurements& mask_rules,
                       std::vector<DeviceRay>& rays, std::vector<DeviceTarget>& targets);

/// Returns the sensor with the nominal rays of a frame's LiDAR (without jitter). If the
/// scan has other rows and columns than the LiDAR, the sensor has the rays of the scan.
SimulatedSensor nominal_sensor(const Config& config, const Log& log, const Frame& frame);

/// Returns rules that ignore moving boxes, except the actors that the scene contains.
IgnoredMeasurements mask_movers(const Config& config, const Scene& scene);

/// Returns which rays of a frame were dropped, [rays]: 0 returned, 1 dropped, -1 if the
/// ray hit, or may have hit, a moving object without a model in the scene.
std::vector<float> classify_drops(const Log& log, const Frame& frame, const IgnoredMeasurements& rules);

/// Returns at most `max_count` frames at regular intervals, or all frames if it is 0.
std::vector<int> select_evenly(const std::vector<int>& frames, int max_count);

}  // namespace relidar
