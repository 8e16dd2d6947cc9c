// SPDX-License-Identifier: Apache-2.0
// Binding of loss/image_loss (Eq. 10).
#include <relidar/loss.hpp>

#include <algorithm>

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

void ImageLoss::run(Stream& stream, const Array<float>& rendered, const Array<DeviceTarget>& targets, std::uint32_t first, std::uint32_t stride,
                    std::uint32_t n_rays, double n_returned, double n_known, Array<float>& upstream, const Array<float>& terms) {
    const LossWeights& w = impl_->weights;
    const float per_return = static_cast<float>(1.0 / std::max(n_returned, 1.0)), per_ray = static_cast<float>(1.0 / std::max(n_known, 1.0));
    relidar::run(stream, impl_->kernel, n_rays,
                 {rendered.address(), targets.address(), upstream.address(), terms.address(), w.depth * per_return, w.intensity * per_return, w.drop * per_ray,
                  w.opacity * per_return, n_rays, first, stride, w.normalised_depth ? 1u : 0u});
}

}  // namespace relidar
