// SPDX-License-Identifier: Apache-2.0
// Gradients of instance poses and of the sensor's pose from record gradients
// (diff/backward/pose_blocks, poses, sensor_pose).
#pragma once

#include <relidar/diff/backward.hpp>

#include "diff/shared/backward.h"
#include "gpu/kernel.hpp"

namespace relidar {

/// Surfels of all instances in blocks, and the sums over each.
struct Gradients::PoseSums {
    Array<shared::PoseBlock> blocks;
    Array<std::uint32_t> first_block;            ///< [instances + 1]
    Array<float, shared::PoseSums> sums;         ///< [blocks, RELIDAR_POSE_SUMS]
    Array<float, shared::ViewGradients> d_view;  ///< [n,3] of activate_vjp

    PoseSums(Device& device, const DeviceScene& scene);
};

/// The three kernels.
class PoseGradients {
public:
    explicit PoseGradients(Device& device);
    /// Fills gradients.poses and gradients.sensor from gradients.records and what
    /// activate_vjp left in pose_sums.
    void run(Stream& stream, const DeviceScene& scene, const ImageModel& model,
             const glm::vec3& view_origin_m, Gradients& gradients);

private:
    Kernel<shared::PoseBlocksParams> blocks_;
    Kernel<shared::PosesParams> poses_;
    Kernel<shared::SensorPoseParams> sensor_;
};

}  // namespace relidar
