// SPDX-License-Identifier: Apache-2.0
// Between the library's arrays (float, structure of arrays) and the oracle's surfels and
// records (double, one struct each), so that a test gives the very same numbers to a
// kernel and to the reference.
#pragma once

#include <vector>

#include <relidar/diff/traversal.hpp>
#include <relidar/scene/scene.hpp>

#include "../reference/traversal.hpp"

namespace relidar::test {

/// Oracle surfels holding exactly the float values of `surfels`.
std::vector<reference::Surfel> to_reference(const Surfels& surfels);
/// Rounds to the library's arrays.
Surfels to_surfels(const std::vector<reference::Surfel>& surfels);
/// Records of section 2 in the model's frame: computed in double, then rounded.
std::vector<reference::FloatRecord> to_records(const Surfels& surfels);
/// The same rays in double.
std::vector<reference::Ray> to_reference(const WorldRays& rays);
/// Rays of a table as they are, sensor frame = world.
WorldRays to_world_rays(const RayTable& table);

/// Surfels `order[i]` of a set, without needing the library.
Surfels take(const Surfels& surfels, const std::vector<std::uint32_t>& order);

}  // namespace relidar::test
