// SPDX-License-Identifier: Apache-2.0
// A user-defined loss. Its kernel runs on the arrays of the training, so no data is
// copied to the host.
#pragma once

#include <algorithm>
#include <filesystem>

#include <relidar/diff/loss.hpp>
#include <relidar/diff/traversal.hpp>
#include <relidar/gpu/kernel.hpp>
#include "robust_loss.h"

/// Robust loss of ranges: weight times the mean of log(1 + (error / scale_m)^2) over all
/// rays with a return.
class RobustLoss final : public relidar::Loss {
public:
    /// @param spirv_file the compiled kernel robust_loss.comp
    RobustLoss(relidar::Device& device, const std::filesystem::path& spirv_file, float weight, float scale_m)
        : kernel_(Kernel::from_spirv(device, spirv_file)), weight_(weight), scale_m_(scale_m) {}

    void add_ray_losses(relidar::Stream& stream, const relidar::RenderedBatch& rays,
                        const relidar::TargetBatch& batch, const relidar::LossTermRow& terms) override {
        relidar::run(stream, kernel_, batch.n_rays,
                     {.rendered = rays.rendered->address(),
                      .targets = batch.targets->address(),
                      .upstream = rays.upstream->address(),
                      .terms = terms.row_address(),
                      .weight = float(weight_ / std::max(batch.n_returned, 1.0)),
                      .scale_m = scale_m_,
                      .n_rays = batch.n_rays,
                      .first_ray = batch.first,
                      .ray_stride = batch.stride});
    }

private:
    using Kernel = relidar::Kernel<relidar::shared::RobustLossParams>;
    Kernel kernel_;
    float weight_, scale_m_;
};
