// SPDX-License-Identifier: Apache-2.0
// The conformance cases every hit provider must pass (docs/architecture.md section 9):
// one list of scenes and rays, in the library's float arrays, so that host and device
// providers are given the very same bits. No expected hits are stored: brute force with
// the float canonical function is the judge.
#pragma once

#include <string>
#include <vector>

#include <relidar/diff/traversal.hpp>
#include <relidar/scene/scene.hpp>

#include "../../reference/traversal.hpp"

namespace relidar::test {

struct TraversalCase {
    std::string name;
    Surfels surfels;
    std::vector<reference::Placement> instances;
    WorldRays rays;
    /// |n.d| down to 1e-3: the outline of a hit is blurred by rounding, so a few may flip
    /// there
    bool grazing = false;
};

/// The case's surfels and placements for the oracle.
reference::World to_world(const TraversalCase& c);

TraversalCase empty_case();
/// One surfel: head on, off centre, in its plane, behind, at the near limit, parallel
/// above the plane.
TraversalCase single_case();
/// Exact copies at one place, within a model and across instances of it.
TraversalCase equal_depth_case();
/// 100 surfels along each ray: more than any chunk.
TraversalCase long_list_case();
/// n surfels along each ray, that end none, three at each distance.
TraversalCase tied_list_case(int n);
/// Through the diagonals, edges and corners of the proxies, and through the rim where
/// alpha = alpha_min, 1 % inside and outside.
TraversalCase outline_case(std::uint64_t seed, int n_rays);
/// |n . d| between 1e-3 and 1e-2.
TraversalCase grazing_case(std::uint64_t seed, int n_rays);
/// Surfels that must never be reported (not finite, zero or overflowing scale, zero
/// quaternion, opacity at or under the cut) among good ones.
TraversalCase degenerate_case();
/// Random surfels of many sizes, all orientations; a second model placed three times,
/// rotated and overlapping.
TraversalCase random_case(std::uint64_t seed, int n_surfels, int n_rays);
/// Surfels of the benchmark street within `radius_m` of the sensor, and every `stride`-th
/// of its rays.
TraversalCase street_case(const Surfels& street, const RayTable& rays, double radius_m, int stride);

/// The same surfels as 3D Gaussians, 0.03 to 0.5 m thick; in one of twenty the thickness
/// is not usable.
TraversalCase as_gaussians(TraversalCase c, std::uint64_t seed);
/// 3D Gaussians larger than the distances between them: rays begin inside of many, and
/// proxies begin before one chunk and end behind the next. With them needles and discs, 1
/// to 1000 and more between their axes.
TraversalCase crowded_case(std::uint64_t seed, int n_gaussians, int n_rays);
/// 3D Gaussians, at sizes that take seconds on a slow device.
std::vector<TraversalCase> gaussian_cases(std::uint64_t seed, int n_rays);

/// The case with instances that move and turn during a sweep of 0.1 s, some for a part of
/// it and one not at all, and rays that are fired at times during and beyond it.
TraversalCase that_moves(TraversalCase c, std::uint64_t seed);
/// Both primitives, at sizes that take seconds on a slow device.
std::vector<TraversalCase> moving_cases(std::uint64_t seed, int n_rays);

/// All surfels but street_case, at sizes that take seconds on a slow device.
std::vector<TraversalCase> conformance_cases(std::uint64_t seed, int n_rays);

}  // namespace relidar::test
