// SPDX-License-Identifier: Apache-2.0
// A beam is a cone: its footprint is cast in parts, and what they return is put together
// as a receiver would. Private to render.
#pragma once

#include <relidar/log/sensor.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar {

/// Rays of the parts of every footprint, n for a ray, in the order of
/// footprint_pattern(). Parts keep the origin, time and channel of their ray.
/// @param n  1, 5 or 9; any other number is a spiral, whose first part lies beside the
/// middle
/// @param divergence_rad  full divergence of all rays; 0: each ray's own
RayTable split_rays(const RayTable& rays, int n, double divergence_rad);

/// One scan of the rays from the scan of their parts. The parts that return are grouped
/// by range, where neighbours lie less than config.return_separation_m apart, or where
/// they lie on one plane; a group is one return, of their mean range, weighted by
/// intensity, and of the sum of their intensities over the number of parts. The strongest
/// group is the ray's return. With config.returns = 2 the last group is its second return
/// where it is not the strongest, else the strongest of the others, and only where it has
/// a tenth of the strongest's intensity. The ray's probability of a drop is the mean of
/// its parts': what comes back is the sum over the footprint. Weight, normal and instance
/// are those of the strongest group's part nearest to the middle.
/// @param parts  a scan of split_rays(rays, config.sub_rays, ...)
RenderedScan join_footprints(const RenderedScan& parts, const RayTable& rays, const SensorConfig& config);

/// Nine parts see a tenth of the light in one of them or in none: where they meet several
/// surfaces the light is measured by so many. At a straight edge one outer part of nine
/// reports a surface that has from 2.6 % of the footprint on.
inline constexpr int kEdgeParts = 40;

/// Rays of which the parts that return are more than one return.
std::vector<std::size_t> find_edges(const RenderedScan& parts, const RayTable& rays,
                                    const SensorConfig& config);
/// Puts the rays of one scan in the place of some of another. @param places [rays of
/// `better`]
void replace_rays(RenderedScan& scan, const std::vector<std::size_t>& places, const RenderedScan& better);

}  // namespace relidar
