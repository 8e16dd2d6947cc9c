// SPDX-License-Identifier: Apache-2.0
// Declares scenes and rays that test every method to find the hits of rays ("hit
// provider", docs/architecture.md section 9). Values are in the library's float arrays,
// so that methods on host and device receive the same bits. The expected hits are
// computed by testing all surfels in float.
#pragma once

#include <string>
#include <vector>

#include <relidar/diff/traversal.hpp>
#include <relidar/scene/scene.hpp>

#include "../../reference/render.hpp"

namespace relidar::test {

struct TraversalCase {
    std::string name;
    Surfels surfels;
    std::vector<reference::Placement> instances;
    WorldRays rays;
    /// True if rays are almost parallel to surfels (|n.d| down to 1e-3). Rounding then
    /// blurs the outline of the surfels, so a few hits may differ.
    bool grazing = false;
};

reference::World to_world(const TraversalCase& test_case);

TraversalCase make_empty_case();
/// Makes a scene with a single surfel. Rays hit the surfel head on, off centre, and at
/// the near limit. Further rays lie in its plane, are parallel to the plane, or start
/// behind the surfel.
TraversalCase make_single_case();
/// Makes exact copies of surfels at the same position, within a model and in several
/// instances.
TraversalCase make_equal_depth_case();
/// Makes a scene with 100 surfels along each ray, more than a search returns at a time.
TraversalCase make_long_list_case();
/// Makes a scene with `count` surfels along each ray, three at each distance. No ray
/// stops early.
TraversalCase make_tied_list_case(int count);
/// Makes rays through the diagonals, edges and corners of the rectangles that bound
/// surfels. Further rays pass 1 % inside and outside the visible rim (alpha = alpha_min).
TraversalCase make_outline_case(std::uint64_t seed, int n_rays);
TraversalCase make_grazing_case(std::uint64_t seed, int n_rays);
/// Makes a scene with surfels that must never be hit (not finite, zero or overflowing
/// scale, zero quaternion, opacity at most alpha_min) among valid surfels.
TraversalCase make_degenerate_case();
/// Makes random surfels of many sizes and all orientations, and a second model with three
/// rotated, overlapping instances.
TraversalCase make_random_case(std::uint64_t seed, int n_surfels, int n_rays);

/// Replaces the surfels by 3D Gaussians that are 0.03 to 0.5 m thick. Every twentieth
/// Gaussian has an invalid thickness.
TraversalCase to_gaussians(TraversalCase test_case, std::uint64_t seed);
/// Makes 3D Gaussians that are larger than the distances between them. Rays start inside
/// many Gaussians, and each Gaussian overlaps more hits than a search returns at a time.
/// The scene also contains needles and discs with axis ratios of 1000 and more.
TraversalCase make_crowded_case(std::uint64_t seed, int n_gaussians, int n_rays);
/// Returns all cases of 3D Gaussians, with sizes that take seconds on a slow device.
std::vector<TraversalCase> make_gaussian_cases(std::uint64_t seed, int n_rays);

/// Returns the case with instances that move and turn during a sweep of 0.1 s. Some
/// instances move only for a part of the sweep, and a single instance does not move. Rays
/// are fired during the sweep and outside it.
TraversalCase make_moving_case(TraversalCase test_case, std::uint64_t seed);
/// Returns cases with moving instances for both primitives, with sizes that take seconds
/// on a slow device.
std::vector<TraversalCase> make_moving_cases(std::uint64_t seed, int n_rays);

/// Returns all surfel cases, with sizes that take seconds on a slow device.
std::vector<TraversalCase> make_conformance_cases(std::uint64_t seed, int n_rays);

}  // namespace relidar::test
