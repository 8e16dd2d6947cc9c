// SPDX-License-Identifier: Apache-2.0
// Computes the position of the vehicle at each frame of a log.
#pragma once

#include <vector>

#include <glm/glm.hpp>

#include <relidar/log/sequence.hpp>

namespace relidar {

/// Returns the position of the vehicle at each frame of a log.
/// @return [frames] metres, world frame
std::vector<glm::dvec3> compute_vehicle_position_per_frame(const LidarSequence& sequence);

/// Returns true if a labelled box exists at the time of a frame and the distance between
/// box and vehicle is at most `max_distance_m`.
bool is_box_within_distance_of_vehicle(const BoxTrack& box, const LidarSequence& sequence, int frame_index,
                                       double max_distance_m);

}  // namespace relidar
