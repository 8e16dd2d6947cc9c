// SPDX-License-Identifier: Apache-2.0
// Binding of loss/surfel_loss: one launch a model.
#include <relidar/loss.hpp>

#include <algorithm>

#include <relidar/scene.hpp>
#include <relidar/sequence.hpp>

#include "core/assert.hpp"
#include "gpu/stream.hpp"
#include "shared/loss.h"

namespace relidar {

std::vector<glm::vec3> box_half_sizes(const Scene& scene, const Sequence& sequence) {
    std::vector<glm::vec3> half(scene.models.size(), glm::vec3(0.0f));
    for (const Instance& instance : scene.instances)
        for (const BoxTrack& box : sequence.boxes)
            if (!instance.track.empty() && box.id == instance.track) half[instance.model] = glm::vec3(0.5 * box.size_m);
    return half;
}

namespace {

shared::SurfelPointers pointers(const SurfelArrays& a) {
    return {a.mean.address(), a.rotation.address(), a.log_scale.address(), a.opacity_logit.address(), a.sh.address()};
}

bool has_box(const glm::vec3& half) { return half.x > 0.0f && half.y > 0.0f && half.z > 0.0f; }

}  // namespace

struct SurfelLoss::Impl {
    LossWeights weights;
    Kernel<shared::SurfelLossParams> kernel;
};

SurfelLoss::SurfelLoss(Device& device, const LossWeights& weights)
    : impl_(new Impl{weights, {device, accumulating_variant(device, "loss/surfel_loss@")}}) {}
SurfelLoss::~SurfelLoss() = default;

void SurfelLoss::run(Stream& stream, const DeviceScene& scene, const std::vector<glm::vec3>& half_sizes_m, const SurfelGradients& gradients, const TermRow& terms) {
    const std::vector<Model>& models = scene.layout().models;
    RELIDAR_ASSERT_LE(models.size(), half_sizes_m.size());
    const LossWeights& w = impl_->weights;
    double n_boxed = 0.0;
    for (std::size_t i = 0; i < models.size(); ++i) n_boxed += has_box(half_sizes_m[i]) ? models[i].count : 0u;
    const float box_weight = static_cast<float>(w.box / std::max(n_boxed, 1.0)), entropy_weight = static_cast<float>(w.opacity_entropy / std::max(double(scene.size()), 1.0));
    for (std::size_t i = 0; i < models.size(); ++i) {
        const glm::vec3 half = has_box(half_sizes_m[i]) ? half_sizes_m[i] : glm::vec3(0.0f);
        if (!(w.opacity_entropy > 0.0f) && !(w.box > 0.0f && has_box(half))) continue;
        relidar::run(stream, impl_->kernel, models[i].count,
                     {pointers(scene.parameters()), pointers(*gradients.d_surfels), gradients.touched ? gradients.touched->address() : 0, terms.address(), half,
                      w.box_scale_share * glm::length(half), box_weight, entropy_weight, models[i].first, models[i].count});
    }
}

}  // namespace relidar
