// SPDX-License-Identifier: Apache-2.0
#include <algorithm>

#include "diff/loss/losses.hpp"

namespace relidar {
namespace {

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

void Loss::add_ray_losses(Stream&, const RenderedBatch&, const TargetBatch&, const LossTermRow&) {}
void Loss::add_regularisers(Stream&, const DeviceScene&, const SurfelGradients&, const LossTermRow&) {}

std::vector<std::unique_ptr<Loss>> make_losses(Device& device, const LossWeights& w, std::uint32_t n_rays) {
    struct WeightedLossFactory {
        float weight;
        LossFactory* maker;
    };
    const WeightedLossFactory terms[] = {
#define RELIDAR_TERM(index, name, setting, maker, standard, accepts, meaning) \
    {w.setting, make_##maker##_loss},
        RELIDAR_LOSS_TERMS(RELIDAR_TERM)
#undef RELIDAR_TERM
    };
    // The image loss must be first, because it overwrites the gradients. All other losses
    // add to them.
    std::vector<LossFactory*> makers{make_image_loss};
    for (const WeightedLossFactory& term : terms)
        if (term.weight > 0.0f && std::find(makers.begin(), makers.end(), term.maker) == makers.end())
            makers.push_back(term.maker);
    std::vector<std::unique_ptr<Loss>> losses;
    for (LossFactory* make : makers) losses.push_back(make(device, w, n_rays));
    return losses;
}

}  // namespace relidar
