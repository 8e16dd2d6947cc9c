// SPDX-License-Identifier: Apache-2.0
// Declares the synthetic street that benchmarks and tests use.
#pragma once

#include <cstdint>
#include <string>

#include <relidar/scene/scene.hpp>

namespace relidar {

/// Returns the surfels of a synthetic street. The same arguments always give the same
/// surfels. Makes benchmark scene A if `refine` is false, and scene B if it is true. The
/// values equal the output of the Python generator, except for rounding in the last
/// digit. The surfels are not sorted in kd-tree order.
Surfels make_benchmark_street(std::uint32_t count, std::uint32_t seed = 20261120, bool refine = false);

/// Returns the rays of the street's sensor at (0, -2, 1.8). The kind is "waymo" (64 x
/// 2650 rays) or "kitti" (66 x 1030 rays). The second overload accepts any number of rays
/// and any vertical field of view.
RayTable make_benchmark_rays(const std::string& kind);
RayTable make_benchmark_rays(int rows, int columns, double top_deg, double bottom_deg);

}  // namespace relidar
