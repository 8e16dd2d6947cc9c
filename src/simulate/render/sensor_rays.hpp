// SPDX-License-Identifier: Apache-2.0
// Keeps the rays of a sensor on the device, transforms them to the sensor's poses, and
// computes the measurements. Private to render.
#pragma once

#include <functional>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <relidar/diff/network_training.hpp>
#include <relidar/diff/traversal.hpp>
#include <relidar/log/sensor.hpp>
#include <relidar/log/sequence.hpp>

#include "gpu/stream.hpp"
#include "simulate/shared/render.h"

namespace relidar {

/// Options for computing the measurements of rendered rays.
struct RayMeasurementOptions {
    const std::string& range;  ///< setting `render.range`
    const std::vector<Beam>& beams;
    const IntensityResponse& response;
    RangeLimits limits;
    /// A ray hits nothing if the sum of its surfels' blending weights is below this
    /// value.
    float min_weight;
};

class DeviceSensorRays {
public:
    explicit DeviceSensorRays(Device& device);

    /// Uploads the rays of a sensor unless they are already on the device. Pending GPU
    /// commands must not use the old rays.
    /// @param sensor_name identifies the sensor; another name forces an upload
    /// @param get_no_return_probability returns the probability that the sensor never
    /// gets a return along a ray, for example because the vehicle blocks the ray
    void upload_ray_table(const RayTable& rays, const std::string& sensor_name,
                          const std::function<float(std::size_t)>& get_no_return_probability);
    /// Records GPU commands that transform the rays to the world frame, each with the
    /// sensor's pose at its firing time. Afterwards get_world_ray_batch() returns the
    /// transformed rays.
    /// @param world_from_sensor poses of the sensor; a single pose if the sensor does not
    /// move
    void record_ray_transform_to_world(Stream& stream, const PoseTrack& world_from_sensor,
                                       double sweep_time_s);
    /// Returns the rays in the world frame, with the rows and columns of the sensor's ray
    /// table.
    RayBatch get_world_ray_batch() const;
    /// Records GPU commands that convert rendering results to measurements, such as range
    /// and intensity, for all rays.
    void record_measurement_of_rendered_rays(Stream& stream, const RenderedBatch& rendered_batch,
                                             const RayMeasurementOptions& options);
    /// Records GPU commands that run a ray-drop network on the measured rays. Afterwards
    /// get_drop_probability_address() returns the address of the result.
    /// @param relative_sensor_position_m sensor position relative to the first vehicle
    /// position of the log
    /// @throws DataError if the image or the channels do not match the network
    void record_ray_drop_inference(Stream& stream, RayDropInference& network,
                                   const glm::vec3& relative_sensor_position_m);
    /// Copies the measurements to the host and waits for them.
    /// @return [rays] valid until the next call
    std::span<const shared::MeasuredRay> wait_for_measurements(Stream& stream);
    /// Returns the drop probability that the network computed for each ray. Call
    /// wait_for_measurements() first. The result is valid until the next call of
    /// wait_for_measurements().
    std::span<const float> wait_for_drop_probabilities(Stream& stream);

    /// Returns true if the device already stores the rays of this table and sensor.
    bool is_ray_table_uploaded(const RayTable& rays, const std::string& sensor_name) const;
    const RayTable& get_ray_table() const { return table_; }
    const std::string& get_sensor_name() const { return sensor_; }
    const Array<shared::SensorRay>& get_device_rays() const { return rays_; }
    const Array<shared::MeasuredRay>& get_device_measurements() const { return measured_; }
    /// Returns the device address of the drop probabilities from the last
    /// record_ray_drop_inference().
    Address<float, shared::DropProbabilities> get_drop_probability_address() const {
        return get_device_address_or_null(refined_);
    }
    /// Returns poses of the sensor during a sweep. To get the pose at the firing time of
    /// a ray, interpolate between them.
    std::vector<shared::SensorPose> list_poses_during_sweep(const PoseTrack& world_from_sensor,
                                                            double sweep_time_s) const;

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
    std::optional<ReadbackBuffer> readback_, refined_readback_;
    Kernel<shared::DropChannelsParams> drop_channels_;
    Array<shared::RenderedSurface> no_surfaces_;  ///< a single entry of zeros
    Array<float, shared::DropSamples> samples_;   ///< inputs of the ray-drop network
    /// Output of the ray-drop network. Null if the network did not run after the last
    /// record_measurement_of_rendered_rays().
    const Array<float, shared::DropProbabilities>* refined_ = nullptr;
};

/// Returns the channel numbers (RELIDAR_DROP_*) of the inputs of a ray-drop network.
/// @throws DataError for an unknown input
std::vector<std::uint32_t> list_drop_network_channel_numbers(const std::vector<std::string>& channel_names);

/// Returns the poses of a sensor during a sweep in the format of the kernels. The list
/// also has one pose before the first ray and one pose after the last ray.
/// @param first_offset_s firing time of the first ray, relative to `sweep_time_s`
/// @param last_offset_s firing time of the last ray, relative to `sweep_time_s`
std::vector<shared::SensorPose> list_poses_between_time_offsets(const PoseTrack& world_from_sensor,
                                                                double sweep_time_s, double first_offset_s,
                                                                double last_offset_s);
/// Transforms the poses of a track from the world frame to another frame.
PoseTrack convert_track_to_frame(PoseTrack track, const Pose& world_from_frame);

}  // namespace relidar
