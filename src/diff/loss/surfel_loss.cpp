// SPDX-License-Identifier: Apache-2.0
#include <relidar/diff/loss.hpp>

#include <algorithm>

#include <relidar/scene/device_scene.hpp>

#include "diff/loss/losses.hpp"
#include "diff/shared/loss.h"
#include "gpu/stream.hpp"

namespace relidar {

struct ActorBoxLoss::Impl {
    Device& device;
    LossWeights weights;
    Kernel<shared::SurfelLossParams> kernel{device, "diff/loss/surfel_loss", atomic_variant(device)};
};

ActorBoxLoss::ActorBoxLoss(Device& d, const LossWeights& w) : impl_(new Impl{d, w}) {}
ActorBoxLoss::~ActorBoxLoss() = default;
std::unique_ptr<Loss> make_surfel_loss(Device& device, const LossWeights& weights, std::uint32_t) {
    return std::make_unique<ActorBoxLoss>(device, weights);
}

void ActorBoxLoss::add_regularisers(Stream& stream, const DeviceScene& scene,
                                    const SurfelGradients& gradients, const LossTermRow& terms) {
    const LossWeights& w = impl_->weights;
    const std::vector<SurfelModel>& models = scene.layout().models;
    double n_boxed = 0.0;
    std::uint32_t first = scene.size(), end = 0;  // surfel range that contains all models with a box
    for (const SurfelModel& m : models) {
        const bool has_box = m.half_size_m.x > 0.0f && m.half_size_m.y > 0.0f && m.half_size_m.z > 0.0f;
        if (!has_box) continue;
        n_boxed += m.count;
        first = std::min(first, m.first);
        end = m.first + m.count;
    }
    if (!(w.box > 0.0f) || first >= end) return;
    relidar::run(stream, impl_->kernel, end - first,
                 {.surfels = surfel_pointers(scene.surfel_parameters()),
                  .d_surfels = surfel_pointers(*gradients.d_surfels),
                  .touched = address_or_null(gradients.touched),
                  .terms = terms.row_address(),
                  .models = scene.model_table().address(),
                  .box_scale_share = w.box_scale_share,
                  .box_weight = float(w.box / std::max(n_boxed, 1.0)),
                  .first_surfel = first,
                  .n_surfels = end - first,
                  .n_models = std::uint32_t(models.size())});
}

}  // namespace relidar
