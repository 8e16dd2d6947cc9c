// SPDX-License-Identifier: Apache-2.0
// Rays of the training frames where the corrected poses of the sensor have them, and
// gradients of rays as gradients of those poses.
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

/// Gradient of one pose of the sensor's track.
struct PoseGradient {
    std::size_t pose = 0;
    Twist gradient{};
};

class MovedRays {
public:
    MovedRays(Device& device, const std::vector<FrameData>& frames);
    /// Records the rays of a frame that is on the device, and has the frame point to
    /// them. They serve until the next call.
    void move(Stream& stream, const TrackCorrection& sensor, FrameData& frame);
    /// Records gradients of the poses between which the batch's rays were fired, from
    /// dL/d(ray) of a backward pass; the frame was moved last. The direction from which
    /// spherical harmonics are seen is taken as fixed.
    void sum_gradients(Stream& stream, const FrameData& frame, const SampledBatch& batch,
                       const Array<float, shared::DeviceRayGradients>& d_rays);
    /// [kRows, poses of a frame at most, 6] of the last sum_gradients().
    const Array<float>& gradient_rows() const { return rows_; }
    /// What they mean, of a frame.
    std::vector<PoseGradient> gradients_in(std::span<const float> gradient_rows,
                                           const FrameData& frame) const;

private:
    /// workgroups a pose: together enough rays at a time for a GPU
    static constexpr std::uint32_t kRows = 16;

    std::uint32_t most_knots_;
    Array<DeviceRay> moved_;         ///< [rays of a frame at most] of the frame moved last
    Array<shared::PoseKnot> knots_;  ///< [most_knots] of the frame moved last
    Array<float, shared::KnotGradientRows> rows_;
    Kernel<shared::MoveRaysParams> move_;
    Kernel<shared::KnotGradientsParams> gradients_;
};

}  // namespace relidar
