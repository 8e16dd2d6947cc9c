// SPDX-License-Identifier: Apache-2.0
// Converts between the arrays of the library (float, structure of arrays) and the structs
// of the reference renderer (double). Tests use it to pass exactly the same numbers to a
// kernel and to the reference.
#pragma once

#include <vector>

#include <relidar/diff/traversal.hpp>
#include <relidar/scene/scene.hpp>

#include "../reference/traversal.hpp"

namespace relidar::test {

/// Returns reference surfels that hold exactly the float values of `surfels`.
std::vector<reference::Surfel> to_reference(const Surfels& surfels);
/// Rounds reference surfels to the float arrays of the library.
Surfels to_surfels(const std::vector<reference::Surfel>& surfels);
/// Computes the records of docs/method.md section 2 in the model's frame, in double, and
/// rounds them to float.
std::vector<reference::FloatRecord> to_records(const Surfels& surfels);
/// Converts world rays to the double rays of the reference.
std::vector<reference::Ray> to_reference(const WorldRays& rays);
/// Converts a ray table to world rays; the sensor frame is the world frame.
WorldRays to_world_rays(const RayTable& table);

/// Returns the surfels of a set in the order of the indices `order`, without code of the
/// library.
Surfels take(const Surfels& surfels, const std::vector<std::uint32_t>& order);

}  // namespace relidar::test
