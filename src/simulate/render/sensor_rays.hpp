// SPDX-License-Identifier: Apache-2.0
// A sensor's rays on the device, fired along its way, and what it measures along them.
// Private to render.
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

/// What a sensor makes of what its rays render.
struct RayMeasuring {
    const std::string& range;  ///< config.render.range
    const std::vector<Beam>& beams;
    const IntensityResponse& response;
    RangeLimits limits;
    float min_weight;  ///< a ray of less has met nothing
};

class SensorRays {
public:
    explicit SensorRays(Device& device);

    /// Takes the rays of a sensor; those it has already stay where they are. Nothing may
    /// be in flight.
    /// @param sensor  whose rays they are: another one may see otherwise along the same
    /// ones
    /// @param never_seen  probability that the sensor never sees anything along a ray
    void take(const RayTable& rays, const std::string& sensor,
              const std::function<float(std::size_t)>& never_seen);
    /// Records the rays of a sweep as batch(), each from where the sensor is at its own
    /// time. @param world_from_sensor  one pose: it stands
    void fire(Stream& stream, const PoseTrack& world_from_sensor, double time_s);
    /// [rays] in the world, as an image where the rays are one.
    RayBatch batch() const;
    /// Records what the sensor measures of batch().
    void measure(Stream& stream, const RenderedBatch& rendered, const RayMeasuring& how);
    /// Records a pass of a ray-drop network over the measured rays; drop_probabilities()
    /// returns the result.
    /// @param origin_m [3] of the sensor, from first_origin() @throws DataError for an
    /// image or channels that do not fit the network
    void refine(Stream& stream, DropPass& network, const glm::vec3& origin_m);
    /// Reads back what was recorded, and waits for it. @return [rays] valid until the
    /// next call
    std::span<const shared::MeasuredRay> wait(Stream& stream);
    /// After wait(): [rays] drop probabilities of the network, valid until the next
    /// wait().
    std::span<const float> refined(Stream& stream);

    /// Whether these are the rays here.
    bool has(const RayTable& rays, const std::string& sensor) const;
    const RayTable& table() const { return table_; }
    const std::string& sensor() const { return sensor_; }
    const Array<shared::SensorRay>& rays() const { return rays_; }
    const Array<shared::MeasuredRay>& measured() const { return measured_; }
    /// Of the network that the last refine() asked.
    Address<float, shared::DropProbabilities> drop_probabilities() const { return address_of(refined_); }
    /// Poses that the rays of a sweep are fired from.
    std::vector<shared::SensorPose> poses(const PoseTrack& track, double time_s) const;

private:
    Device& device_;
    Kernel<shared::FireRaysParams> fire_;
    Kernel<shared::MeasureRaysParams> measure_;
    RayTable table_;                        ///< of the rays on the device
    float first_s_ = 0.0f, last_s_ = 0.0f;  ///< when the first and the last of them is fired
    std::string sensor_;
    Array<shared::SensorRay> rays_;
    Array<shared::DeviceRay> fired_;
    Array<shared::MeasuredRay> measured_;
    std::optional<Readback> readback_, refined_readback_;
    Kernel<shared::DropChannelsParams> drop_channels_;
    Array<shared::RenderedSurface> no_surfaces_;                        ///< one of zeros
    Array<float, shared::DropSamples> samples_;                         ///< for a network
    const Array<float, shared::DropProbabilities>* refined_ = nullptr;  ///< by it, since the last measure()
};

/// Numbers (RELIDAR_DROP_*) of the inputs of a ray-drop network. @throws DataError for an
/// unknown input
std::vector<std::uint32_t> drop_channels(const std::vector<std::string>& names);

/// Poses of a sensor through a sweep as kernels read them: those at or before its first
/// ray to those at or behind its last one.
/// @param first_s @param last_s  time offsets of the sweep's rays
std::vector<shared::SensorPose> poses_through_sweep(const PoseTrack& world_from_sensor, double time_s,
                                                    double first_s, double last_s);
/// The same motion in another frame.
PoseTrack seen_from(PoseTrack track, const Pose& world_from_frame);

}  // namespace relidar
