// SPDX-License-Identifier: Apache-2.0
// Binding of loss/image_loss (Eq. 10).
#include <relidar/loss.hpp>

#include <algorithm>

#include "core/assert.hpp"
#include "gpu/stream.hpp"
#include "shared/loss.h"

namespace relidar {

static_assert(sizeof(shared::RayTarget) == sizeof(DeviceTarget));
static_assert(sizeof(shared::RayGradient) == kUpstreamFloats * sizeof(float) && RELIDAR_LOSS_TERMS == kLossTerms);

struct ImageLoss::Impl {
    LossWeights weights;
    Kernel<shared::ImageLossParams> kernel;
};

ImageLoss::ImageLoss(Device& device, const LossWeights& weights)
    : impl_(new Impl{weights, {device, accumulating_variant(device, "loss/image_loss@")}}) {}
ImageLoss::~ImageLoss() = default;

void ImageLoss::run(Stream& stream, const TargetBatch& batch, const Array<float>& rendered, Array<float>& upstream, const Array<float>& terms, std::uint32_t slot) {
    RELIDAR_ASSERT_LE(std::size_t(batch.n_rays) * kUpstreamFloats, upstream.size());
    RELIDAR_ASSERT_LE(batch.first + (std::size_t(batch.n_rays) - 1) * batch.stride + 1, batch.targets->size());
    RELIDAR_ASSERT_LE((std::size_t(slot) + 1) * kLossTerms, terms.size());
    const std::uint64_t slot_address = terms.address() + std::uint64_t(slot) * kLossTerms * sizeof(float);
    const LossWeights& w = impl_->weights;
    const float per_return = static_cast<float>(1.0 / std::max(batch.n_returned, 1.0)), per_ray = static_cast<float>(1.0 / std::max(batch.n_known, 1.0));
    relidar::run(stream, impl_->kernel, batch.n_rays,
                 {rendered.address(), batch.targets->address(), upstream.address(), slot_address, w.depth * per_return, w.intensity * per_return, w.drop * per_ray,
                  w.opacity * per_return, batch.n_rays, batch.first, batch.stride, w.normalised_depth ? 1u : 0u});
}

}  // namespace relidar
