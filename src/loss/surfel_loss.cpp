// SPDX-License-Identifier: Apache-2.0
// Binding of loss/surfel_loss: one launch a model.
#include <relidar/stages/loss.hpp>

#include <algorithm>

#include <relidar/stages/scene.hpp>

#include "gpu/stream.hpp"
#include "shared/loss.h"

namespace relidar {

namespace {

shared::SurfelPointers pointers(const SurfelArrays& a) {
    return {a.mean.address(), a.rotation.address(), a.log_scale.address(), a.opacity_logit.address(), a.sh.address(), a.log_scale_w.address()};
}

bool has_box(const Model& m) { return m.half_size_m.x > 0.0f && m.half_size_m.y > 0.0f && m.half_size_m.z > 0.0f; }

}  // namespace

struct SurfelLoss::Impl {
    LossWeights weights;
    Kernel<shared::SurfelLossParams> kernel;
};

SurfelLoss::SurfelLoss(Device& device, const LossWeights& weights)
    : impl_(new Impl{weights, {device, accumulating_variant(device, "loss/surfel_loss@")}}) {}
SurfelLoss::~SurfelLoss() = default;

void SurfelLoss::regularise(Stream& stream, const DeviceScene& scene, const SurfelGradients& gradients, const TermRow& terms) {
    const LossWeights& w = impl_->weights;
    double n_boxed = 0.0;
    for (const Model& m : scene.layout().models) n_boxed += has_box(m) ? m.count : 0u;
    const float box_weight = static_cast<float>(w.box / std::max(n_boxed, 1.0)), entropy_weight = static_cast<float>(w.opacity_entropy / std::max(double(scene.size()), 1.0));
    const Concurrent models(stream);   // each has surfels of its own, and the terms are added atomically
    for (const Model& m : scene.layout().models) {
        const glm::vec3 half = has_box(m) ? m.half_size_m : glm::vec3(0.0f);
        if (!(w.opacity_entropy > 0.0f) && !(w.box > 0.0f && has_box(m))) continue;
        relidar::run(stream, impl_->kernel, m.count,
                     {.surfels = pointers(scene.parameters()),
                      .d_surfels = pointers(*gradients.d_surfels),
                      .touched = address_of(gradients.touched),
                      .terms = terms.address(),
                      .half_size = half,
                      .largest_scale = w.box_scale_share * glm::length(half),
                      .box_weight = box_weight,
                      .entropy_weight = entropy_weight,
                      .first_surfel = m.first,
                      .n_surfels = m.count});
    }
}

}  // namespace relidar
