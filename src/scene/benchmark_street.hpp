// SPDX-License-Identifier: Apache-2.0
// The street that benchmarks and tests measure on.
#pragma once

#include <cstdint>
#include <string>

#include <relidar/scene/scene.hpp>

namespace relidar {

/// Returns the deterministic street of surfels that the benchmarks use: scene A without
/// `refine`, scene B with it. Equals the Python generator of these scenes up to the last
/// place; surfels are not in kd order.
Surfels make_benchmark_street(std::uint32_t n, std::uint32_t seed = 20261120, bool refine = false);

/// Its rays: kind "waymo" (64 x 2650) or "kitti" (66 x 1030), all from (0, -2, 1.8); or
/// any size with a given field of view.
RayTable make_benchmark_rays(const std::string& kind);
RayTable make_benchmark_rays(int rows, int columns, double top_deg, double bottom_deg);

}  // namespace relidar
