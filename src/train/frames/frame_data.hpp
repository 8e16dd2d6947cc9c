// SPDX-License-Identifier: Apache-2.0
// A training frame on the device: world rays, each from where the sensor was when it
// fired, and what each measured.
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

/// Rays of a frame on the device. The arrays may be longer than the frame: they serve
/// several, one after the other.
struct FrameArrays {
    Array<DeviceRay> rays;        ///< [n] of the poses with which training began
    Array<DeviceTarget> targets;  ///< [n]
    /// [n] in the poses of the vehicle, from FrameData::first_knot; none where those stay
    Array<shared::RayPlace> places;
};

/// One training frame.
struct FrameData {
    int position = 0;  ///< in Sequence::frames
    int index = 0;     ///< the dataset's own number
    std::uint32_t n_rays = 0;
    ImageShape image;                           ///< of the rays; none where the sensor has no image order
    std::size_t first_knot = 0;                 ///< first pose of the vehicle between which rays were fired
    std::uint32_t n_knots = 0;                  ///< such poses
    std::shared_ptr<const FrameArrays> arrays;  ///< where the frame is on the device, or comes to
    const Array<DeviceRay>* moved_rays = nullptr;  ///< [n] of corrected poses, where there are any
    double n_returned = 0.0;  ///< known rays that returned, once the frame was on the device
    double n_known = 0.0;
    std::vector<InstancePose> placed;   ///< of all instances of the scene
    glm::vec3 sensor_position_m{0.0f};  ///< world, at the reference time

    const Array<DeviceRay>& rays() const { return moved_rays ? *moved_rays : arrays->rays; }
    const Array<DeviceTarget>& targets() const { return arrays->targets; }
    /// Every stride-th ray from `first` on.
    RayBatch batch(std::uint32_t first, std::uint32_t stride) const;
};

/// Rays of the largest of some frames; 0 of none.
std::uint32_t most_rays(std::span<const FrameData> frames);

/// What training must not look at.
struct Unknown {
    InitialiseOptions moving;         ///< which boxes are actors, masked, or of the background
    std::vector<std::string> actors;  ///< boxes that have a model of their own: these are known
    DropTable observed_drops;         ///< rays that these call blind (is_blind); empty = none
};

/// Rays and targets of one frame on the host. Rays that meet a moving box about where
/// they returned, or that were dropped and may have met one, are unknown (weight 0): the
/// background must not learn them.
void make_targets(const Sequence& sequence, const Frame& frame, const Unknown& unknown,
                  std::vector<DeviceRay>& rays, std::vector<DeviceTarget>& targets);

}  // namespace relidar
