// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include <glm/glm.hpp>

#include <relidar/log/sequence.hpp>

namespace relidar {

/// @return [frames] metres, world frame
std::vector<glm::dvec3> compute_vehicle_position_per_frame(const LidarSequence& sequence);

/// True if the box exists at the time of the frame within `max_distance_m` of the
/// vehicle.
bool is_box_within_distance_of_vehicle(const BoxTrack& box, const LidarSequence& sequence, int frame_index,
                                       double max_distance_m);

}  // namespace relidar
