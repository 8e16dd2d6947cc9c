// SPDX-License-Identifier: Apache-2.0
// Binding of loss/image_loss (Eq. 10) and the sum of its terms.
#include <relidar/loss.hpp>

#include <algorithm>

#include "core/assert.hpp"
#include "gpu/stream.hpp"
#include "gpu/sum_rows.hpp"
#include "shared/loss.h"

namespace relidar {

static_assert(sizeof(shared::RayTarget) == sizeof(DeviceTarget));
static_assert(sizeof(shared::RayGradient) == kUpstreamFloats * sizeof(float) && RELIDAR_LOSS_TERMS == kLossTerms);

struct ImageLoss::Impl {
    Device& device;
    LossWeights weights;
    Kernel<shared::ImageLossParams> kernel;
    Array<float> terms;             ///< [rays of the largest batch, kLossTerms]
    std::unique_ptr<SumRows> sum;   ///< the same in every run, unlike atomics

    Impl(Device& d, const LossWeights& w) : device(d), weights(w), kernel(d, "loss/image_loss") {}

    /// Waits where the batch is larger than any before.
    void reserve(Stream& stream, std::uint32_t n_rays) {
        if (sum && n_rays <= sum->most()) return;
        stream.finish();
        terms = Array<float>(device, std::size_t(n_rays) * kLossTerms, "loss terms of rays");
        sum = std::make_unique<SumRows>(device, n_rays, kLossTerms);
    }
};

ImageLoss::ImageLoss(Device& device, const LossWeights& weights) : impl_(new Impl(device, weights)) {}
ImageLoss::~ImageLoss() = default;

void ImageLoss::run(Stream& stream, const TargetBatch& batch, const Array<float>& rendered, Array<float>& upstream, const Array<float>& terms) {
    RELIDAR_ASSERT_LE(std::size_t(batch.n_rays) * kUpstreamFloats, upstream.size());
    RELIDAR_ASSERT_LE(batch.first + (std::size_t(batch.n_rays) - 1) * batch.stride + 1, batch.targets->size());
    RELIDAR_ASSERT_LE(std::size_t(kLossTerms), terms.size());
    const LossWeights& w = impl_->weights;
    const float per_return = static_cast<float>(1.0 / std::max(batch.n_returned, 1.0)), per_ray = static_cast<float>(1.0 / std::max(batch.n_known, 1.0));
    impl_->reserve(stream, batch.n_rays);
    relidar::run(stream, impl_->kernel, batch.n_rays,
                 {rendered.address(), batch.targets->address(), upstream.address(), impl_->terms.address(), w.depth * per_return, w.intensity * per_return, w.drop * per_ray,
                  w.opacity * per_return, batch.n_rays, batch.first, batch.stride, w.normalised_depth ? 1u : 0u});
    impl_->sum->add(stream, impl_->terms.address(), batch.n_rays, terms.address());
}

}  // namespace relidar
