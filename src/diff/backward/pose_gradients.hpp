// SPDX-License-Identifier: Apache-2.0
// Computes the gradients of instance poses and of the sensor pose from the gradients of
// surfel records.
#pragma once

#include <relidar/diff/backward.hpp>

#include "diff/shared/backward.h"
#include "gpu/kernel.hpp"

namespace relidar {

/// Buffers for the gradients of instance poses. The surfels of each instance are divided
/// into blocks, and a workgroup sums the gradients of one block.
struct DeviceGradients::PoseGradientSums {
    Array<shared::PoseBlock> blocks;
    Array<std::uint32_t> first_block;            ///< [instances + 1] first block of each instance
    Array<float, shared::PoseSums> sums;         ///< [blocks, RELIDAR_POSE_SUMS] sum of each block
    Array<float, shared::ViewGradients> d_view;  ///< [n,3] gradient of the view directions

    PoseGradientSums(Device& device, const DeviceScene& scene);
};

class PoseGradientKernels {
public:
    explicit PoseGradientKernels(Device& device);
    /// Computes the gradients of the instances' poses and of the sensor's pose, as sums
    /// of the surfels' gradients.
    void reduce(Stream& stream, const DeviceScene& scene, const ImageModel& model,
                const glm::vec3& view_origin_m, DeviceGradients& gradients);

private:
    static constexpr std::uint32_t kThreads = 64;  ///< threads per workgroup
    static constexpr SpecialisationConstant kWorkgroup{SpecialisationConstantId::WORKGROUP_SIZE, kThreads};

    Kernel<shared::PoseBlocksParams> blocks_;  ///< sums surfels over blocks
    Kernel<shared::PosesParams> poses_;        ///< sums blocks over instances
    Kernel<shared::SensorPoseParams> sensor_;  ///< sums instances over the scene
};

}  // namespace relidar
