// SPDX-License-Identifier: Apache-2.0
// Declares the synthetic street that benchmarks and tests use.
#pragma once

#include <relidar/scene/scene.hpp>

namespace relidar {

/// Returns the surfels of a synthetic street, which depend only on the arguments. If
/// `shrink` is true (benchmark scene B), the surfels become
/// smaller as `n_surfels` grows. The values equal those of the Python generator up to
/// rounding in the last digit. The surfels are not sorted in kd-tree order.
Surfels make_street_surfels(std::uint32_t n_surfels, std::uint32_t seed = 20261120, bool shrink = false);

/// Returns the LiDAR rays of the street, with their origin at (0, -2, 1.8) m.
/// `name` is "waymo" (64 x 2650 rays) or "kitti" (66 x 1030 rays). The second
/// overload accepts any number of rays and any vertical field of view.
RayTable make_street_rays(const std::string& name);
RayTable make_street_rays(int rows, int columns, double top_deg, double bottom_deg);

}  // namespace relidar
