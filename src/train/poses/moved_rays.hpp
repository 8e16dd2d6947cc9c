// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include <relidar/gpu/stream.hpp>
#include <relidar/log/sequence.hpp>

#include "gpu/kernel.hpp"
#include "train/frames/batch.hpp"
#include "train/frames/frame_data.hpp"
#include "train/poses/track_correction.hpp"
#include "train/shared/train.h"

namespace relidar {

struct PoseGradient {
    std::size_t pose = 0;
    Twist gradient{};
};

class PoseCorrectedRays {
public:
    PoseCorrectedRays(Device& device, const std::vector<TrainingFrameData>& frames);
    /// Moves the rays of a frame to the corrected poses. The frame must be on the device.
    /// Afterwards `frame` refers to the new rays, which are valid until the next call.
    void move_rays(Stream& stream, const TrackCorrection& correction, TrainingFrameData& frame);
    /// A ray contributes to the poses before and after its firing time. Ignores the
    /// effect of poses on the viewing direction of the spherical harmonics. Call
    /// move_rays() for the same frame before.
    void record_sums(Stream& stream, const TrainingFrameData& frame, const SampledBatch& batch,
                     const Array<float, shared::DeviceRayGradients>& ray_gradients);
    /// [kGroupsPerPose, maximum number of poses in a frame, 6] one row for each of the
    /// `kGroupsPerPose` workgroups that share the work for a pose
    const Array<float>& gradient_sums() const { return rows_; }
    std::vector<PoseGradient> sum_gradients(std::span<const float> sums,
                                            const TrainingFrameData& frame) const;

private:
    /// workgroups per pose, so that the GPU has enough parallel work
    static constexpr std::uint32_t kGroupsPerPose = 16;

    std::uint32_t most_knots_;
    Array<DeviceRay> moved_;         ///< [maximum rays of a frame] rays of the frame of the last move_rays()
    Array<shared::PoseKnot> knots_;  ///< [most_knots_] poses of the same frame
    Array<float, shared::KnotGradientRows> rows_;
    Kernel<shared::MoveRaysParams> move_;
    Kernel<shared::KnotGradientsParams> gradients_;
};

}  // namespace relidar
