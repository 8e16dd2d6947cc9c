// SPDX-License-Identifier: Apache-2.0
// Binding of loss/relative_range: differences of ln(1 + range).
#include <algorithm>

#include <relidar/stages/traversal.hpp>

#include "core/assert.hpp"
#include "gpu/stream.hpp"
#include "loss/losses.hpp"
#include "shared/loss.h"

namespace relidar {
namespace {

class RelativeRangeLoss final : public Loss {
public:
    RelativeRangeLoss(Device& device, const LossWeights& weights)
        : weights_(weights), kernel_(device, "loss/relative_range", accumulating_variant(device)) {}

    void compare(Stream& stream, const RenderedBatch& rendered, const TargetBatch& batch, const TermRow& terms) override {
        RELIDAR_ASSERT_LE(std::size_t(batch.n_rays), rendered.upstream->size());
        run(stream, kernel_, batch.n_rays,
            {.rendered = rendered.rendered->address(),
             .targets = batch.targets->address(),
             .upstream = rendered.upstream->address(),
             .terms = terms.address(),
             .weight = static_cast<float>(weights_.relative_range / std::max(batch.n_returned, 1.0)),
             .n_rays = batch.n_rays,
             .first_ray = batch.first,
             .ray_stride = batch.stride,
             .normalised_depth = weights_.normalised_depth ? 1u : 0u});
    }

private:
    LossWeights weights_;
    Kernel<shared::RelativeRangeParams> kernel_;
};

}  // namespace

std::unique_ptr<Loss> make_relative_range_loss(Device& device, const LossWeights& weights, std::uint32_t) {
    return std::make_unique<RelativeRangeLoss>(device, weights);
}

}  // namespace relidar
