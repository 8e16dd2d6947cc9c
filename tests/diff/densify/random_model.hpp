// SPDX-License-Identifier: Apache-2.0
// Makes scenes for tests of densification: random surfels in models of the requested
// sizes. The first model has no box. In the remaining models, some surfels lie outside
// the box. SH coefficients contain the index of each surfel.
#pragma once

#include <vector>

#include <relidar/scene/scene.hpp>

#include "../../reference/densify.hpp"

namespace relidar::test {

/// Makes models with random surfels.
/// @param counts number of surfels of each model
Scene random_model_scene(const std::vector<std::uint32_t>& counts, std::uint64_t seed);

/// Makes every 20th surfel non-finite, each in a different parameter.
void poison(Surfels& surfels);

/// Converts surfel i to the type of the reference.
reference::DensifiedSurfel densified(const Surfels& surfels, std::size_t i);

/// Returns the index that random_model_scene() stored in the SH coefficients of surfel i.
std::uint32_t tag_of(const Surfels& surfels, std::size_t i);

}  // namespace relidar::test
