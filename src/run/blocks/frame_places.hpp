// SPDX-License-Identifier: Apache-2.0
// Where a log's vehicle was at its sweeps.
#pragma once

#include <vector>

#include <glm/glm.hpp>

#include <relidar/log/sequence.hpp>

namespace relidar {

/// Positions of the vehicle at the frames of a log. @return [frames] world
std::vector<glm::dvec3> frame_places(const Sequence& sequence);

/// Whether a box is present at a frame, within so many metres of the vehicle.
bool is_within(const BoxTrack& box, const Sequence& sequence, int position, double metres);

}  // namespace relidar
