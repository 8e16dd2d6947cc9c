// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include <glm/glm.hpp>

#include <relidar/log/sequence.hpp>

namespace relidar {

/// @return [frames] metres, world frame
std::vector<glm::dvec3> list_positions(const Log& sequence);

/// True if the box exists at the time of the frame within `max_distance_m` of the
/// vehicle.
bool is_near_box(const BoxTrack& box, const Log& sequence, int frame, double max_distance_m);

}  // namespace relidar
