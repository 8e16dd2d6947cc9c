// SPDX-License-Identifier: Apache-2.0
// Binding of diff/loss/geometry_loss and diff/loss/normal_vjp (docs/method.md M10-M12).
#include <relidar/diff/loss.hpp>

#include <algorithm>

#include <relidar/diff/traversal.hpp>

#include "base/assert.hpp"
#include "diff/shared/geometry_loss.h"
#include "gpu/stream.hpp"

namespace relidar {

struct GeometryLoss::Impl {
    LossWeights weights;
    Array<glm::vec3> d_tangents;
    Kernel<shared::GeometryLossParams> loss, normal_vjp;
};

GeometryLoss::GeometryLoss(Device& device, const LossWeights& weights, std::uint32_t n_rays)
    : impl_(new Impl{weights,
                     {device, weights.normal > 0.0f ? 2 * std::size_t(n_rays) : 0, "tangent gradients"},
                     {device, "diff/loss/geometry_loss", accumulating_variant(device)},
                     {device, "diff/loss/normal_vjp"}}) {}
GeometryLoss::~GeometryLoss() = default;
std::unique_ptr<Loss> make_geometry_loss(Device& device, const LossWeights& weights, std::uint32_t n_rays) {
    return std::make_unique<GeometryLoss>(device, weights, n_rays);
}

void GeometryLoss::compare(Stream& stream, const RenderedBatch& rendered, const TargetBatch& batch,
                           const TermRow& terms) {
    const LossWeights& w = impl_->weights;
    RayGeometry& geometry = *rendered.geometry;
    const bool with_normals = w.normal > 0.0f;
    RELIDAR_ASSERT_LE(std::size_t(batch.n_rays), geometry.gradient.size());
    RELIDAR_ASSERT_LE(with_normals ? 2 * std::size_t(batch.n_rays) : 0, impl_->d_tangents.size());
    RELIDAR_ASSERT_LE(with_normals ? 1u : 0u, batch.image.rows);
    const float per_return = static_cast<float>(1.0 / std::max(batch.n_returned, 1.0));
    const shared::GeometryLossParams params{.rays = rendered.rays.rays->address(),
                                            .rendered = rendered.rendered->address(),
                                            .geometry = geometry.rendered.address(),
                                            .targets = batch.targets->address(),
                                            .d_tangents = impl_->d_tangents.address(),
                                            .upstream = rendered.upstream->address(),
                                            .d_geometry = geometry.gradient.address(),
                                            .terms = terms.address(),
                                            .distortion_weight = w.distortion * per_return,
                                            .normal_weight = w.normal * per_return,
                                            .likelihood_weight = w.likelihood * per_return,
                                            .likelihood_floor = w.likelihood_floor,
                                            .n_rays = batch.n_rays,
                                            .first_ray = batch.first,
                                            .ray_stride = batch.stride,
                                            .rows = batch.image.rows,
                                            .columns = batch.image.columns,
                                            .circular = batch.image.circular ? 1u : 0u,
                                            .normalised_depth = w.normalised_depth ? 1u : 0u};
    relidar::run(stream, impl_->loss, batch.n_rays, params);
    if (with_normals) relidar::run(stream, impl_->normal_vjp, batch.n_rays, params);
}

}  // namespace relidar
