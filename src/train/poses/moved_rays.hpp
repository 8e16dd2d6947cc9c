// SPDX-License-Identifier: Apache-2.0
// Computes the rays of training frames from corrected sensor poses, and converts
// gradients of rays to gradients of these poses.
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
    /// Records the computation of the rays of a frame that is on the device, and lets the
    /// frame refer to them. They are valid until the next call.
    void move(Stream& stream, const TrackCorrection& sensor, FrameData& frame);
    /// Records the gradients of the poses between which the batch's rays were fired, from
    /// dL/d(ray) of a backward pass. The frame must be the one that was moved last. The
    /// direction for evaluating spherical harmonics is treated as constant.
    void sum_gradients(Stream& stream, const FrameData& frame, const SampledBatch& batch,
                       const Array<float, shared::DeviceRayGradients>& d_rays);
    /// Returns [kRows, maximum poses of a frame, 6] partial sums of the last
    /// sum_gradients().
    const Array<float>& gradient_rows() const { return rows_; }
    /// Sums the rows to a gradient for each pose of a frame.
    std::vector<PoseGradient> gradients_in(std::span<const float> gradient_rows,
                                           const FrameData& frame) const;

private:
    /// Workgroups for each pose: enough parallel rays to use a GPU.
    static constexpr std::uint32_t kRows = 16;

    std::uint32_t most_knots_;
    Array<DeviceRay> moved_;         ///< [maximum rays of a frame] rays of the frame that was moved last
    Array<shared::PoseKnot> knots_;  ///< [most_knots] poses of the frame that was moved last
    Array<float, shared::KnotGradientRows> rows_;
    Kernel<shared::MoveRaysParams> move_;
    Kernel<shared::KnotGradientsParams> gradients_;
};

}  // namespace relidar
