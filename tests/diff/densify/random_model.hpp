// SPDX-License-Identifier: Apache-2.0
// Scenes for tests of densification: random surfels in models of given sizes, the first
// unbounded, the others in a box that some of them leave; each surfel carries its index
// in its SH coefficients.
#pragma once

#include <vector>

#include <relidar/scene/scene.hpp>

#include "../../reference/densify.hpp"

namespace relidar::test {

/// @param counts surfels of each model
Scene random_model_scene(const std::vector<std::uint32_t>& counts, std::uint64_t seed);

/// Makes every 20th surfel not finite, each in another way.
void poison(Surfels& surfels);

/// Surfel i for the reference.
reference::DensifiedSurfel densified(const Surfels& surfels, std::size_t i);

/// The index that random_model_scene gave surfel i.
std::uint32_t tag_of(const Surfels& surfels, std::size_t i);

}  // namespace relidar::test
