// SPDX-License-Identifier: Apache-2.0
// Which rays look how near to the sun; private to render.
#pragma once

#include <vector>

#include <relidar/diff/forward.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar {

/// Towards the sun, dataset's world. @return [3] unit
glm::dvec3 direction_of(const Sun& sun);

/// Angles between the rays of a scan and the sun. @param renderer  of the scene as it is
/// at the scan
/// @return [rays] radians; empty where there is no sun, and where the scene hides it from
/// the sensor
std::vector<float> angles_from_sun(const RenderedScan& scan, const Sun& sun, const glm::dvec3& world_offset_m,
                                   Renderer& renderer);

}  // namespace relidar
