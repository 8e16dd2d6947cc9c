// SPDX-License-Identifier: Apache-2.0
// The training frames on the device: world rays, each from where the sensor was when it fired, and what each measured.
#pragma once

#include <vector>

#include <relidar/config.hpp>
#include <relidar/stages/gpu.hpp>
#include <relidar/stages/loss.hpp>
#include <relidar/sequence.hpp>
#include <relidar/stages/traversal.hpp>

namespace relidar {

/// One frame, resident on the device.
struct FrameData {
    int position = 0;                 ///< in Sequence::frames
    int index = 0;                    ///< the dataset's own number
    Array<DeviceRay> rays;            ///< [n]
    Array<DeviceTarget> targets;      ///< [n]
    std::uint32_t n_rays = 0;
    ImageShape image;                 ///< of the rays; none where the sensor has no image order
    double n_returned = 0.0;          ///< known rays that returned
    double n_known = 0.0;
    std::vector<InstancePose> placed;    ///< of all instances of the scene
    glm::vec3 sensor_position_m{0.0f};   ///< world, at the reference time

    /// Every stride-th ray from `first` on.
    RayBatch batch(std::uint32_t first, std::uint32_t stride) const;
};

/// What training must not look at.
struct Unknown {
    InitialiseOptions moving;   ///< which boxes move, and their margin
    std::vector<std::string> actors;   ///< boxes that have a model of their own: these are known
    DropTable blind;            ///< rays dropped at least kBlindFrequency of the time; empty = none
};

/// Rays and targets of one frame on the host. Rays that meet a moving box about where they returned, or that were dropped and may
/// have met one, are unknown (weight 0): the background must not learn them.
void make_targets(const Sequence& sequence, const Frame& frame, const Unknown& unknown, std::vector<DeviceRay>& rays,
                  std::vector<DeviceTarget>& targets);

/// @throws DataError where a frame has no usable ray
std::vector<FrameData> upload_frames(Device& device, const Sequence& sequence, const std::vector<int>& positions, const Unknown& unknown);

}  // namespace relidar
