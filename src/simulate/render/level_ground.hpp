// SPDX-License-Identifier: Apache-2.0
// Detects level ground in a scan, on which water forms a film. Private to render.
#pragma once

#include <vector>

#include <glm/glm.hpp>

#include <relidar/simulate/render.hpp>

namespace relidar {

/// Finds the points of the background that lie on level ground below the sensor. The
/// candidates in each cell of 2 m are the points within 0.25 m of the lowest point. A
/// cell is ground if the candidates of the 3 x 3 cells around it fit a plane within 0.1
/// m. The slope of the plane must be below 1/4. The material of the ground is not
/// considered.
/// @return [rays] unit normal of the ground in the dataset's world frame; 0 for rays that
/// do not hit ground or do not return
std::vector<glm::dvec3> level_ground(const RenderedScan& scan);

}  // namespace relidar
