// SPDX-License-Identifier: Apache-2.0
#include <relidar/diff/loss.hpp>

#include <algorithm>

#include <relidar/diff/traversal.hpp>

#include "base/assert.hpp"
#include "diff/shared/loss.h"
#include "gpu/stream.hpp"

namespace relidar {

struct ImageLoss::Impl {
    Device& device;
    LossWeights weights;
    std::size_t n_rays;
    Kernel<shared::ImageLossParams> kernel{device, "diff/loss/image_loss", atomic_variant(device)};
    Kernel<shared::SsimParams> ssim{device, "diff/loss/ssim", atomic_variant(device)};
    Kernel<shared::SsimParams> ssim_vjp{device, "diff/loss/ssim_vjp"};
    Array<float, shared::SsimStatistics> statistics{
        device, weights.intensity_ssim > 0.0f ? n_rays* RELIDAR_SSIM_FLOATS : 0, "structural similarity"};
};

ImageLoss::ImageLoss(Device& d, const LossWeights& w, std::uint32_t n) : impl_(new Impl{d, w, n}) {}
ImageLoss::~ImageLoss() = default;

/// Records the losses of depth, intensity, drops and opacity of each ray, and the
/// structural similarity (SSIM) of the intensity image if its weight is positive. Sums
/// over rays become means: most terms are divided by the number of returns.
void ImageLoss::add_ray_losses(Stream& stream, const RenderedBatch& rays, const TargetBatch& batch,
                               const LossTermRow& terms) {
    const Array<shared::RenderedRay>& rendered = *rays.rendered;
    Array<shared::RayGradient>& upstream = *rays.upstream;
    RELIDAR_ASSERT_LE(std::size_t(batch.n_rays), upstream.size());
    RELIDAR_ASSERT_LE(batch.first + (std::size_t(batch.n_rays) - 1) * batch.stride + 1,
                      batch.targets->size());
    const LossWeights& w = impl_->weights;
    const float per_return = float(1.0 / std::max(batch.n_returned, 1.0));
    const float per_ray = float(1.0 / std::max(batch.n_known_rays, 1.0));
    relidar::run(stream, impl_->kernel, batch.n_rays,
                 {.rendered = rendered.address(),
                  .targets = batch.targets->address(),
                  .upstream = upstream.address(),
                  .terms = terms.row_address(),
                  .depth_weight = w.depth * per_return,
                  .intensity_weight = (1.0f - w.intensity_ssim) * w.intensity * per_return,
                  .drop_weight = w.drop * per_ray,
                  .opacity_weight = w.opacity * per_return,
                  .intensity_delta = w.intensity_delta,
                  .n_rays = batch.n_rays,
                  .first_ray = batch.first,
                  .ray_stride = batch.stride,
                  .normalised_depth = w.normalised_depth ? 1u : 0u});
    const bool uses_ssim = w.intensity_ssim * w.intensity > 0.0f;
    if (!uses_ssim) return;
    const ImageShape& image = batch.image;
    RELIDAR_ASSERT_LE(1u, image.rows);
    RELIDAR_ASSERT_LE(std::size_t(batch.n_rays) * RELIDAR_SSIM_FLOATS, impl_->statistics.size());
    const shared::SsimParams ssim{.rendered = rendered.address(),
                                  .targets = batch.targets->address(),
                                  .statistics = impl_->statistics.address(),
                                  .upstream = upstream.address(),
                                  .terms = terms.row_address(),
                                  .weight = w.intensity_ssim * w.intensity * per_return,
                                  .first_ray = batch.first,
                                  .ray_stride = batch.stride,
                                  .rows = image.rows,
                                  .columns = image.columns,
                                  .circular = image.circular ? 1u : 0u};
    relidar::run(stream, impl_->ssim, batch.n_rays, ssim);
    relidar::run(stream, impl_->ssim_vjp, batch.n_rays, ssim);
}

}  // namespace relidar
