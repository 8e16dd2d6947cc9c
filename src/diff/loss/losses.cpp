// SPDX-License-Identifier: Apache-2.0
// Creates all losses in the list of loss terms. Checks the order of the list.
#include <algorithm>

#include "diff/loss/losses.hpp"

namespace relidar {
namespace {

constexpr bool are_terms_in_order() {
#define RELIDAR_TERM(index, name, setting, maker, standard, accepts, meaning) index,
    const std::size_t indices[] = {RELIDAR_LOSS_TERMS(RELIDAR_TERM)};
#undef RELIDAR_TERM
    std::size_t next = 0;
    for (const std::size_t index : indices)
        if (index != next++) return false;
    return true;
}
static_assert(are_terms_in_order(), "the places of loss terms count up from 0");

}  // namespace

void Loss::compare(Stream&, const RenderedBatch&, const TargetBatch&, const TermRow&) {}
void Loss::regularise(Stream&, const DeviceScene&, const SurfelGradients&, const TermRow&) {}

std::vector<std::unique_ptr<Loss>> make_losses(Device& device, const LossWeights& weights,
                                               std::uint32_t n_rays) {
    struct Term {
        float weight;
        LossMaker* maker;
    };
    const Term terms[] = {
#define RELIDAR_TERM(index, name, setting, maker, standard, accepts, meaning) \
    {weights.setting, make_##maker##_loss},
        RELIDAR_LOSS_TERMS(RELIDAR_TERM)
#undef RELIDAR_TERM
    };
    // The image loss must be first, because it overwrites the gradients to which all
    // other losses add.
    std::vector<LossMaker*> makers{make_image_loss};
    for (const Term& term : terms)
        if (term.weight > 0.0f && std::find(makers.begin(), makers.end(), term.maker) == makers.end())
            makers.push_back(term.maker);
    std::vector<std::unique_ptr<Loss>> losses;
    for (LossMaker* make : makers) losses.push_back(make(device, weights, n_rays));
    return losses;
}

}  // namespace relidar
