// SPDX-License-Identifier: Apache-2.0
// Declares the synthetic street that benchmarks and tests use.
#pragma once

#include <relidar/scene/scene.hpp>

namespace relidar {

/// Returns the surfels of a synthetic street, which depend only on the arguments. The
/// values equal those of the Python generator up to rounding in the last digit. The
/// surfels are not sorted in kd-tree order.
/// @param shrink  true (benchmark scene B): surfels become smaller as `n_surfels` grows
Surfels make_street_surfels(std::uint32_t n_surfels, std::uint32_t seed = 20261120, bool shrink = false);

/// Returns LiDAR rays in the street, with their origin at (0, -2, 1.8) m, through the
/// centres of the cells of a full turn.
/// @param top_deg,bottom_deg  limits of the elevation
RayTable make_street_rays(int rows, int columns, double top_deg, double bottom_deg);
/// Returns the rays of a known LiDAR.
/// @param name  "waymo" (64 x 2650 rays) or "kitti" (66 x 1030 rays)
RayTable make_street_rays(const std::string& name);

}  // namespace relidar
