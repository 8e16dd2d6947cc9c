// SPDX-License-Identifier: Apache-2.0
// Keeps the rays of a sensor on the device, transforms them to the sensor's poses, and
// computes the measurements. Private to render.
#pragma once

#include <relidar/diff/network_training.hpp>
#include <relidar/diff/traversal.hpp>
#include <relidar/log/log.hpp>

#include "gpu/stream.hpp"
#include "simulate/shared/render.h"

namespace relidar {

using SensorPoses = std::vector<shared::SensorPose>;
using RayFunction = std::function<float(std::size_t)>;  ///< value of the ray with this index

struct RayMeasurementOptions {
    const std::string& range;  ///< setting `render.range`
    const std::vector<Beam>& beams;
    const IntensityResponse& response;
    RangeLimits limits;
    /// a ray hits nothing if the sum of its blending weights is below this value
    float min_weight;
    std::vector<float> actor_logits = {};  ///< RayDropNetwork::actor_logits of these beams
};

/// Results of the device for each ray, in host memory.
struct ScanMeasurements {
    std::span<const shared::MeasuredRay> rays;
    std::span<const float> network_drops;  ///< drop probabilities; empty if no network ran
};

/// Returns the intensity response of each channel of a sensor that is not of the log:
/// mean gain and offset of the beams of the log's LiDAR whose elevations are nearest to
/// the channel. Its own response is unknown. Gains and offsets of neighbouring beams have
/// a common part, for example because they hit the ground at similar ranges, which the
/// intensities of the scene lack.
/// @param log_beams if empty, the result is empty, too
std::vector<Beam> mean_responses(const RayTable& rays, const std::vector<Beam>& log_beams);

class DeviceSensorRays {
public:
    explicit DeviceSensorRays(Device& device);

    /// Uploads the rays of a sensor unless they are already on the device. Pending GPU
    /// commands must not use the old rays.
    /// @param drop_probability probability that the sensor never gets a return along a
    /// ray, for example because the vehicle blocks it
    void upload(const RayTable& rays, const std::string& name, const RayFunction& drop_probability);
    /// Records GPU commands that transform the rays to the world frame, each with the
    /// sensor's pose at its firing time. Then world_batch() returns them.
    /// @param world_from_sensor a single pose if the sensor does not move
    void place(Stream& stream, const PoseTrack& world_from_sensor, double sweep_time_s);
    RayBatch world_batch() const;
    /// Records GPU commands that convert rendering results to ranges and intensities.
    void record_measure(Stream& stream, const RenderedBatch& batch, const RayMeasurementOptions& options);
    /// Records GPU commands that run a ray-drop network on the measured rays. Then
    /// network_drops() has the result.
    /// @param sensor_m relative to the first vehicle position of the log
    /// @throws DataError if the image or the channels do not match the network
    void record_drop(Stream& stream, RayDropInference& network, const glm::vec3& sensor_m);
    /// Copies the measurements to the host and waits for them.
    /// @return valid until the next call
    ScanMeasurements wait_measured(Stream& stream);

    bool has_rays_of(const RayTable& rays, const std::string& sensor_name) const;
    const RayTable& ray_table() const { return table_; }
    const std::string& sensor_name() const { return sensor_; }
    const Array<shared::SensorRay>& device_rays() const { return rays_; }
    const Array<shared::MeasuredRay>& device_measured() const { return measured_; }
    /// Null if no network ran after the last record_measure().
    const Array<float, shared::DropProbabilities>* network_drops() const { return network_drops_; }
    SensorPoses sweep_poses(const PoseTrack& world_from_sensor, double time_s) const;

private:
    Device& device_;
    Kernel<shared::FireRaysParams> fire_;
    Kernel<shared::MeasureRaysParams> measure_;
    RayTable table_;                        ///< copy of the rays on the device
    float first_s_ = 0.0f, last_s_ = 0.0f;  ///< time offsets of the first and the last fired ray
    std::string sensor_;
    Array<shared::SensorRay> rays_;
    Array<shared::DeviceRay> fired_;
    Array<shared::MeasuredRay> measured_;
    std::optional<ReadbackBuffer> measured_readback_, drops_readback_;
    Kernel<shared::DropChannelsParams> drop_channels_;
    /// A single entry of zeros, which the kernel reads if the scene has no surfaces.
    Array<shared::RenderedSurface> no_surfaces_;
    Array<float, shared::DropSamples> samples_;  ///< inputs of the ray-drop network
    const Array<float, shared::DropProbabilities>* network_drops_ = nullptr;
};

/// Returns RELIDAR_DROP_*.
/// @throws DataError for an unknown input
std::vector<std::uint32_t> channel_numbers(const std::vector<std::string>& channels);

SensorPoses poses_between(const PoseTrack& world_from_sensor, double time_s, double first_s, double last_s);
PoseTrack to_frame(PoseTrack track, const Pose& world_from_frame);

}  // namespace relidar
