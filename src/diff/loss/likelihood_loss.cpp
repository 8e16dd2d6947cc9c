// SPDX-License-Identifier: Apache-2.0
#include <relidar/diff/loss.hpp>

#include <algorithm>

#include <relidar/diff/traversal.hpp>

#include "base/assert.hpp"
#include "diff/shared/likelihood_loss.h"
#include "gpu/stream.hpp"

namespace relidar {

struct LikelihoodLoss::Impl {
    Device& device;
    LossWeights weights;
    Kernel<shared::LikelihoodLossParams> kernel{device, "diff/loss/likelihood_loss", atomic_variant(device)};
};

LikelihoodLoss::LikelihoodLoss(Device& d, const LossWeights& w) : impl_(new Impl{d, w}) {}
LikelihoodLoss::~LikelihoodLoss() = default;

/// Records the loss -ln(f + (1 - f) S), averaged over the rays with a return. S is the
/// rendered likelihood of the measured range. The floor f limits the loss of outliers.
/// Adds the derivative to `upstream`, the gradient of the rendered values of each ray.
void LikelihoodLoss::add_ray_losses(Stream& stream, const RenderedBatch& rays, const TargetBatch& batch,
                                    const LossTermRow& terms) {
    const LossWeights& weights = impl_->weights;
    RELIDAR_ASSERT_LE(std::size_t(batch.n_rays), rays.upstream->size());
    const float per_return = float(1.0 / std::max(batch.n_returned, 1.0));
    relidar::run(stream, impl_->kernel, batch.n_rays,
                 {.rendered = rays.rendered->address(),
                  .targets = batch.targets->address(),
                  .upstream = rays.upstream->address(),
                  .terms = terms.row_address(),
                  .weight = weights.likelihood * per_return,
                  .likelihood_floor = weights.likelihood_floor,
                  .n_rays = batch.n_rays,
                  // Ray i of the batch has the target first_ray + i * ray_stride.
                  .first_ray = batch.first,
                  .ray_stride = batch.stride});
}

}  // namespace relidar
