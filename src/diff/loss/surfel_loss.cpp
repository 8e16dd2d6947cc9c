// SPDX-License-Identifier: Apache-2.0
#include <relidar/diff/loss.hpp>

#include <algorithm>

#include <relidar/scene/device_scene.hpp>

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

/// Records the loss of surfels that are outside the box of their actor or large compared
/// with it, as a mean over the surfels of all models with a box. Adds its gradients to
/// the surfels' gradients.
void ActorBoxLoss::add_regularisers(Stream& stream, const DeviceScene& scene,
                                    const SurfelGradients& gradients, const LossTermRow& terms) {
    const LossWeights& w = impl_->weights;
    const std::vector<SurfelModel>& models = scene.layout().models;
    // The kernel skips the surfels of models without a box (half_size_m is 0).
    double n_boxed = 0.0;                         // number of surfels of models with a box
    std::uint32_t first = scene.size(), end = 0;  // surfel range that contains all these models
    for (const SurfelModel& model : models) {
        const glm::vec3& half_size_m = model.half_size_m;
        const bool has_box = half_size_m.x > 0.0f && half_size_m.y > 0.0f && half_size_m.z > 0.0f;
        if (!has_box) continue;
        n_boxed += model.count;
        first = std::min(first, model.first);
        end = model.first + model.count;
    }
    const bool is_enabled = w.box > 0.0f;
    if (!is_enabled || first >= end) return;
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
