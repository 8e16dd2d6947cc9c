// SPDX-License-Identifier: Apache-2.0
// Computes the position of the vehicle at each frame of a log.
#pragma once

#include <vector>

#include <glm/glm.hpp>

#include <relidar/log/sequence.hpp>

namespace relidar {

/// Returns the position of the vehicle at each frame of a log.
/// @return [frames] metres, world frame
std::vector<glm::dvec3> compute_frame_positions(const Sequence& sequence);

/// Returns true if a labelled box exists at the time of a frame and is at most `metres`
/// away from the vehicle.
bool is_within(const BoxTrack& box, const Sequence& sequence, int position, double metres);

}  // namespace relidar
