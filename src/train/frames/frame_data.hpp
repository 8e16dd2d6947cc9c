// SPDX-License-Identifier: Apache-2.0
// A training frame on the device: world rays, each from the sensor's pose at its firing
// time, and their measurements.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include <relidar/diff/loss.hpp>
#include <relidar/diff/traversal.hpp>
#include <relidar/gpu/stream.hpp>
#include <relidar/log/sequence.hpp>
#include <relidar/run/config.hpp>

#include "train/shared/train.h"

namespace relidar {

/// Arrays of a frame's rays on the device. They can be longer than the frame, because
/// several frames use them in turn.
struct FrameArrays {
    Array<DeviceRay> rays;        ///< [n] rays with the poses at the start of training
    Array<DeviceTarget> targets;  ///< [n] measurements
    /// [n] positions of the rays in the vehicle's track, counted from
    /// FrameData::first_knot. Empty if poses are not corrected.
    Array<shared::RayPlace> places;
};

/// A training frame.
struct FrameData {
    int position = 0;  ///< index into Sequence::frames
    int index = 0;     ///< frame number of the dataset
    std::uint32_t n_rays = 0;
    ImageShape image;            ///< shape of the ray image; empty if the sensor has no image order
    std::size_t first_knot = 0;  ///< index of the first vehicle pose that the rays use
    std::uint32_t n_knots = 0;   ///< number of vehicle poses that the rays use
    std::shared_ptr<const FrameArrays> arrays;  ///< arrays that hold the frame while it is on the device
    /// [n] rays with corrected poses; null if poses are not corrected
    const Array<DeviceRay>* moved_rays = nullptr;
    double n_returned = 0.0;  ///< known rays with a return; set when the frame is first uploaded
    double n_known = 0.0;
    std::vector<InstancePose> placed;   ///< poses of all instances of the scene
    glm::vec3 sensor_position_m{0.0f};  ///< sensor position at the reference time, world frame

    const Array<DeviceRay>& rays() const { return moved_rays ? *moved_rays : arrays->rays; }
    const Array<DeviceTarget>& targets() const { return arrays->targets; }
    /// Returns every stride-th ray, starting at `first`.
    RayBatch batch(std::uint32_t first, std::uint32_t stride) const;
};

/// Returns the number of rays of the largest frame, or 0 if there are no frames.
std::uint32_t most_rays(std::span<const FrameData> frames);

/// Measurements that training must ignore.
struct Unknown {
    InitialiseOptions moving;  ///< determines which boxes are actors, masked, or part of the background
    std::vector<std::string> actors;  ///< tracks of boxes with a model; their points are known
    DropTable observed_drops;         ///< excludes rays for which is_blind() is true; empty: excludes none
};

/// Computes the rays and targets of a frame on the host. Two kinds of rays are unknown
/// and get weight 0, because the background must not learn them: rays that returned from
/// inside a moving box, and dropped rays that may have hit one.
void make_targets(const Sequence& sequence, const Frame& frame, const Unknown& unknown,
                  std::vector<DeviceRay>& rays, std::vector<DeviceTarget>& targets);

}  // namespace relidar
