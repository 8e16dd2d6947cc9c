// SPDX-License-Identifier: Apache-2.0
// Compares the ordered hits of two methods. Ids and order should be equal. Differences
// are classified as flips, swaps and errors. A flip is a hit on the opacity limit (M2) or
// on the near plane, within single precision. A swap means two distances t that rounding
// cannot distinguish. Tests require no errors, and no or few flips and swaps.
#pragma once

#include <string>
#include <vector>

#include "../../reference/render.hpp"

namespace relidar::test {

struct HitDifferences {
    std::size_t n_rays = 0;
    std::size_t n_hits = 0;  ///< hits of the expected provider
    std::size_t n_different_rays = 0;
    std::size_t n_flips = 0;
    std::size_t n_swaps = 0;
    std::size_t n_errors = 0;
    std::string first_error;

    std::string summary(const std::string& title) const;
};

/// Compares the expected and the actual hits of a ray and adds the result to
/// `differences`.
/// @param ray_index index of the ray for messages
void compare_hits(const reference::World& world, const ImageModel& model, const reference::Ray& ray,
                  std::size_t ray_index, const std::vector<reference::Hit>& expected,
                  const std::vector<reference::Hit>& actual, HitDifferences& differences);

/// Returns true if single precision can decide either way: |ln(alpha / alpha_min)| or |t
/// - near| is within the rounding error. For a surfel, the error of the intersection
/// grows as 1 / |n . d|. For a 3D Gaussian, it is the error of a point in standard
/// deviations.
bool is_on_boundary(const reference::World& world, const ImageModel& model, const reference::Ray& ray,
                    const reference::Hit& hit);

}  // namespace relidar::test
