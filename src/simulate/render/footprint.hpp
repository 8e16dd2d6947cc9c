// SPDX-License-Identifier: Apache-2.0
// Models a LiDAR beam as a cone. Traces several sub-rays through the cone, and joins
// their hits to returns like the receiver of a LiDAR. Private to render.
#pragma once

#include <relidar/log/log.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar {

using RayIndices = std::vector<std::size_t>;

/// Splits each ray into sub-rays, ordered from the centre outwards. A sub-ray has the
/// origin, time and channel of its ray.
/// @param sub_rays_per_ray 1, 5 or 9; with any other number, the sub-rays form a spiral
/// @param divergence_rad full divergence of all rays; if 0, each ray has its own
/// divergence
RayTable split_rays(const RayTable& rays, int sub_rays_per_ray, double divergence_rad);

/// Joins the returns of sub-rays to the returns of the beams. Hits form a group if they
/// lie on the same plane, or have gaps below config.return_separation_m in range. Each
/// group forms one return, with the mean range, weighted by received power, and the sum
/// of intensities divided by the number of all sub-rays.
///
/// The group with the largest received power (the sum of reflectivity / range^2) is the
/// return of the beam. If config.returns is 2, the last of the groups that the sensor can
/// detect is the second return (the second strongest if the last is the strongest). The
/// drop probability is the mean over the sub-rays. Weight, normal and instance are copied
/// from a sub-ray near the joined range.
/// @param parts scan of split_rays(rays, config.sub_rays, ...)
/// @param response converts intensities to reflectivities
/// @param sensor limits of detection
RenderedScan join_sub_rays(const RenderedScan& parts, const RayTable& beams, const SensorConfig& config,
                           const IntensityResponse& response = {},
                           const WeatherSensorProperties& sensor = {});

/// Sub-rays of a beam that hits several surfaces. With only nine, one sub-ray could cause
/// a second return, even if the surface fills a tiny part of the beam.
inline constexpr int kEdgeParts = 40;

/// Returns the indices of the beams that hit several surfaces, so that their sub-rays
/// form more than one return.
RayIndices find_edge_beams(const RenderedScan& parts, const RayTable& beams, const SensorConfig& config);
/// Replaces some rays of a scan by the rays of a more exact scan.
/// @param rays [rays of `replacement`] indices of the replaced rays
void replace_rays(RenderedScan& scan, const RayIndices& rays, const RenderedScan& replacement);

}  // namespace relidar
