// SPDX-License-Identifier: Apache-2.0
#include <algorithm>

#include "diff/loss/losses.hpp"

namespace relidar {
namespace {

// Returns true if the table of loss terms numbers them 0, 1, 2, ... in this order.
constexpr bool are_terms_sorted() {
#define RELIDAR_TERM(index, name, setting, maker, standard, accepts, meaning) index,
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

/// Creates the losses with a positive weight. A loss can compute several terms, for
/// example the image loss those of depth, intensity and drops.
std::vector<std::unique_ptr<Loss>> make_losses(Device& device, const LossWeights& weights,
                                               std::uint32_t n_rays) {
    struct WeightedLossFactory {
        float weight;
        LossFactory* make_loss;
    };
    // The table has a row per term, with its weight and the loss that computes it.
    const WeightedLossFactory terms[] = {
#define RELIDAR_TERM(index, name, setting, maker, standard, accepts, meaning) \
    {weights.setting, make_##maker##_loss},
        RELIDAR_LOSS_TERMS(RELIDAR_TERM)
#undef RELIDAR_TERM
    };
    // The image loss must be first, because it overwrites the gradients. All other losses
    // add to them.
    std::vector<LossFactory*> factories{make_image_loss};
    for (const WeightedLossFactory& term : terms) {
        const bool is_listed = std::ranges::find(factories, term.make_loss) != factories.end();
        if (term.weight > 0.0f && !is_listed) factories.push_back(term.make_loss);
    }
    std::vector<std::unique_ptr<Loss>> losses;
    for (LossFactory* make_loss : factories) losses.push_back(make_loss(device, weights, n_rays));
    return losses;
}

// A loss overrides at least one of these functions.
void Loss::add_ray_losses(Stream&, const RenderedBatch&, const TargetBatch&, const LossTermRow&) {}
void Loss::add_regularisers(Stream&, const DeviceScene&, const SurfelGradients&, const LossTermRow&) {}

}  // namespace relidar
