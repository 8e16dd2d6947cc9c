// SPDX-License-Identifier: Apache-2.0
// Computes the angle between each ray and the direction to the sun. Private to render.
#pragma once

#include <vector>

#include <relidar/diff/forward.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar {

/// Returns the direction towards the sun in the dataset's world frame.
/// @return [3] unit vector
glm::dvec3 direction_of(const Sun& sun);

/// Returns the angles between the rays of a scan and the direction to the sun.
/// @param renderer renderer of the scene at the time of the scan
/// @return [rays] radians; empty without a sun, or if the scene hides the sun from the
/// sensor
std::vector<float> angles_from_sun(const RenderedScan& scan, const Sun& sun, const glm::dvec3& world_offset_m,
                                   Renderer& renderer);

}  // namespace relidar
