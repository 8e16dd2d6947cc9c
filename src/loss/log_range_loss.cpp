// SPDX-License-Identifier: Apache-2.0
// Binding of loss/log_range.
#include <relidar/stages/loss.hpp>

#include <algorithm>

#include <relidar/stages/traversal.hpp>

#include "core/assert.hpp"
#include "gpu/stream.hpp"
#include "shared/loss.h"

namespace relidar {

struct LogRangeLoss::Impl {
    LossWeights weights;
    Kernel<shared::LogRangeParams> kernel;
};

LogRangeLoss::LogRangeLoss(Device& device, const LossWeights& weights)
    : impl_(new Impl{weights, {device, "loss/log_range", accumulating_variant(device)}}) {}
LogRangeLoss::~LogRangeLoss() = default;

void LogRangeLoss::compare(Stream& stream, const RenderedBatch& rendered, const TargetBatch& batch, const TermRow& terms) {
    RELIDAR_ASSERT_LE(std::size_t(batch.n_rays), rendered.upstream->size());
    const float weight = static_cast<float>(impl_->weights.log_range / std::max(batch.n_returned, 1.0));
    run(stream, impl_->kernel, batch.n_rays,
        {.rendered = rendered.rendered->address(),
         .targets = batch.targets->address(),
         .upstream = rendered.upstream->address(),
         .terms = terms.address(),
         .weight = weight,
         .n_rays = batch.n_rays,
         .first_ray = batch.first,
         .ray_stride = batch.stride,
         .normalised_depth = impl_->weights.normalised_depth ? 1u : 0u});
}

}  // namespace relidar
