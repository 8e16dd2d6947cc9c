// SPDX-License-Identifier: Apache-2.0
// The list of losses, and that the list of terms is one.
#include <relidar/stages/loss.hpp>

#include "shared/loss.h"

namespace relidar {
namespace {

constexpr bool are_in_order() {
#define RELIDAR_TERM(index, name, setting, standard, accepts, meaning) index,
    const std::size_t indices[] = {RELIDAR_LOSS_TERMS(RELIDAR_TERM)};
#undef RELIDAR_TERM
    std::size_t next = 0;
    for (const std::size_t index : indices)
        if (index != next++) return false;
    return true;
}
static_assert(are_in_order(), "the places of loss terms count up from 0");

}  // namespace

void Loss::compare(Stream&, const RenderedBatch&, const TargetBatch&, const TermRow&) {}
void Loss::regularise(Stream&, const DeviceScene&, const SurfelGradients&, const TermRow&) {}

std::vector<std::unique_ptr<Loss>> make_losses(Device& device, const LossWeights& weights, std::uint32_t n_rays) {
    std::vector<std::unique_ptr<Loss>> losses;
    losses.push_back(std::make_unique<ImageLoss>(device, weights, n_rays));
    if (weights.uses_geometry() || weights.likelihood > 0.0f) losses.push_back(std::make_unique<GeometryLoss>(device, weights, n_rays));
    if (weights.chamfer > 0.0f) losses.push_back(std::make_unique<ChamferLoss>(device, weights, n_rays));
    if (weights.box > 0.0f) losses.push_back(std::make_unique<SurfelLoss>(device, weights));
    return losses;
}

}  // namespace relidar
