// SPDX-License-Identifier: Apache-2.0
// How much of what a scan looks at its log has looked at. Private to render.
#pragma once

#include <cstddef>
#include <vector>

#include <relidar/coverage.hpp>
#include <relidar/render.hpp>

namespace relidar {

/// Shares of the ways of some rays, each from its origin to what it meets, or to the end of its range, that rays of the log have looked
/// along. @param max_range_m  how far a ray is followed at most @param world_offset_m  Sequence::world_offset_m
/// @return [rays] 0..1
std::vector<float> seen_shares(const RenderedScan& scan, const std::vector<std::size_t>& rays, const Coverage& coverage,
                               const glm::dvec3& world_offset_m, double max_range_m);

/// Tells what a scan sees of what its log has seen. @param per_ray  RenderedScan::seen too; else some thousand of its rays are asked alone
void tell_seen(RenderedScan& scan, const Coverage& coverage, const glm::dvec3& world_offset_m, double max_range_m, bool per_ray);

}  // namespace relidar
