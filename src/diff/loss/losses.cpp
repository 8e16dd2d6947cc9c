// SPDX-License-Identifier: Apache-2.0
#include <relidar/diff/loss.hpp>

namespace relidar {
namespace {

// Returns true if the table of loss terms numbers them 0, 1, 2, ... in this order.
constexpr bool are_terms_sorted() {
#define RELIDAR_TERM(index, ...) index,
    const std::size_t indices[] = {RELIDAR_LOSS_TERMS(RELIDAR_TERM)};
#undef RELIDAR_TERM
    std::size_t next = 0;
    for (const std::size_t index : indices)
        if (index != next++) return false;
    return true;
}
static_assert(are_terms_sorted(),
              "RELIDAR_LOSS_TERMS must list the terms with the indices 0, 1, 2, ... in this order");

}  // namespace

/// Creates the image loss and the losses with a positive weight. The image loss is first,
/// because it overwrites the gradients of rendered values. The others add to them.
std::vector<std::unique_ptr<Loss>> make_losses(Device& device, const LossWeights& weights,
                                               std::uint32_t n_rays) {
    std::vector<std::unique_ptr<Loss>> losses;
    losses.push_back(std::make_unique<ImageLoss>(device, weights, n_rays));
    if (weights.box > 0.0f) losses.push_back(std::make_unique<ActorBoxLoss>(device, weights));
    if (weights.chamfer > 0.0f) losses.push_back(std::make_unique<ChamferLoss>(device, weights, n_rays));
    if (weights.likelihood > 0.0f) losses.push_back(std::make_unique<LikelihoodLoss>(device, weights));
    return losses;
}

// A loss overrides at least one of these functions.
void Loss::add_ray_losses(Stream&, const RenderedBatch&, const TargetBatch&, const LossTermRow&) {}
void Loss::add_regularisers(Stream&, const DeviceScene&, const SurfelGradients&, const LossTermRow&) {}

}  // namespace relidar
