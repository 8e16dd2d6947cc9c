// SPDX-License-Identifier: Apache-2.0
// Converts between the arrays of the library (float, structure of arrays) and the surfels
// and records of the reference (double, array of structures). A test can thus pass the
// same numbers to a kernel and to the reference.
#pragma once

#include <vector>

#include <relidar/diff/traversal.hpp>
#include <relidar/scene/scene.hpp>

#include "../reference/render.hpp"

namespace relidar::test {

std::vector<reference::Surfel> to_reference(const Surfels& surfels);
Surfels to_surfels(const std::vector<reference::Surfel>& surfels);
std::vector<reference::Ray> to_reference(const WorldRays& rays);
WorldRays to_world_rays(const RayTable& table);

/// Returns the surfels with the indices `order`, without using the library.
Surfels take(const Surfels& surfels, const std::vector<std::uint32_t>& order);

}  // namespace relidar::test
