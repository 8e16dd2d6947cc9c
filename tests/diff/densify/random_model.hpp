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
Scene make_random_model_scene(const std::vector<std::uint32_t>& counts, std::uint64_t seed);

void fill_with_nan(Surfels& surfels);

reference::DensifiedSurfel densify_surfel(const Surfels& surfels, std::size_t index);

/// Index that make_random_model_scene() stored in the SH coefficients.
std::uint32_t get_tag(const Surfels& surfels, std::size_t index);

}  // namespace relidar::test
