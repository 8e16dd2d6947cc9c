// SPDX-License-Identifier: Apache-2.0
// Positions of a log's vehicle at its frames.
#pragma once

#include <vector>

#include <glm/glm.hpp>

#include <relidar/log/sequence.hpp>

namespace relidar {

/// Returns the positions of the vehicle at the frames of a log.
/// @return [frames] metres, world frame
std::vector<glm::dvec3> frame_places(const Sequence& sequence);

/// Returns true if a box is present at a frame and is within a distance of the vehicle.
bool is_within(const BoxTrack& box, const Sequence& sequence, int position, double metres);

}  // namespace relidar
