// SPDX-License-Identifier: Apache-2.0
// Models a beam as a cone: samples its footprint by sub-rays and joins their returns as a
// receiver would. Private to render.
#pragma once

#include <relidar/log/sensor.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar {

/// Returns n sub-rays for each ray, in the order of footprint_pattern(). Sub-rays keep
/// the origin, time and channel of their ray.
/// @param n 1, 5 or 9; any other number gives a spiral, whose first sub-ray is next to
/// the centre
/// @param divergence_rad full divergence of all rays; 0 selects the divergence of each
/// ray
RayTable split_rays(const RayTable& rays, int n, double divergence_rad);

/// Joins the returns of sub-rays to the returns of the rays. Sub-rays that return are
/// grouped by range: neighbours are in the same group if their ranges differ by less than
/// config.return_separation_m or if they lie on the same plane. A group is one return.
/// Its range is the mean range, weighted by intensity; its intensity is the sum of
/// intensities divided by the number of sub-rays.
///
/// The strongest group is the return of the ray. With config.returns = 2, the second
/// return is the last group, or the second strongest if the last group is the strongest.
/// It must have at least a tenth of the strongest group's intensity. The drop probability
/// is the mean over the sub-rays, because the returned light is the sum over the
/// footprint. Weight, normal and instance are those of the sub-ray in the strongest group
/// that is nearest to the centre.
/// @param parts scan of split_rays(rays, config.sub_rays, ...)
RenderedScan join_footprints(const RenderedScan& parts, const RayTable& rays, const SensorConfig& config);

/// Number of sub-rays at edges. Nine sub-rays hit a surface with a tenth of the light
/// once or never. At a straight edge, a single outer sub-ray of nine reports a surface
/// that covers only 2.6 % of the footprint. Beams that hit several surfaces therefore use
/// more sub-rays.
inline constexpr int kEdgeParts = 40;

/// Returns the indices of the rays whose sub-rays form more than one return.
std::vector<std::size_t> find_edges(const RenderedScan& parts, const RayTable& rays,
                                    const SensorConfig& config);
/// Replaces some rays of a scan by the rays of another scan.
/// @param places [rays of `better`] indices of the replaced rays
void replace_rays(RenderedScan& scan, const std::vector<std::size_t>& places, const RenderedScan& better);

}  // namespace relidar
