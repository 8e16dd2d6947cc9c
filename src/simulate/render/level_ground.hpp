// SPDX-License-Identifier: Apache-2.0
// The ground in a scan, on which water stands; private to render.
#pragma once

#include <vector>

#include <glm/glm.hpp>

#include <relidar/simulate/render.hpp>

namespace relidar {

/// Where the points of the background lie on level ground: in cells of 2 m those within
/// 0.25 m of the lowest, if with those of the cells around they lie within 0.1 m of a
/// plane that rises by less than a quarter, below the sensor. What the ground is made of
/// is not known.
/// @return [rays] unit normal of the ground, dataset's world; 0 for rays that do not meet
/// it or do not return
std::vector<glm::dvec3> level_ground(const RenderedScan& scan);

}  // namespace relidar
