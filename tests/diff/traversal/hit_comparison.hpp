// SPDX-License-Identifier: Apache-2.0
// Compares the ordered hits of two providers. Equal ids in equal order is the rule; what
// differs is sorted into flips (the hit lies on a boundary: cut of M2, near plane, within
// what single precision can resolve), swaps (two t that rounding cannot tell apart) and
// errors. Tests demand zero errors, and zero or few of the others.
#pragma once

#include <string>
#include <vector>

#include "../../reference/traversal.hpp"

namespace relidar::test {

struct HitDifferences {
    std::size_t n_rays = 0;
    std::size_t n_hits = 0;  ///< of the expected provider
    std::size_t n_different_rays = 0;
    std::size_t n_flips = 0;
    std::size_t n_swaps = 0;
    std::size_t n_errors = 0;
    std::string first_error;

    std::string summary(const std::string& title) const;
};

/// Adds one ray to `differences`. @param ray_index  for messages
void compare_hits(const reference::World& world, const ImageModel& model, const reference::Ray& ray,
                  std::size_t ray_index, const std::vector<reference::Hit>& expected,
                  const std::vector<reference::Hit>& actual, HitDifferences& differences);

/// Whether single precision can decide either way about a surfel: |ln(alpha / alpha_min)|
/// or |t - near| within the rounding of the plane hit, which grows as 1 / |n . d|; of a
/// 3D Gaussian, within that of a point in standard deviations.
bool on_boundary(const reference::World& world, const ImageModel& model, const reference::Ray& ray,
                 const reference::Hit& hit);

}  // namespace relidar::test
