// SPDX-License-Identifier: Apache-2.0
// Computes the position of the vehicle at each frame of a log.
#include "run/blocks/frame_places.hpp"

namespace relidar {

std::vector<glm::dvec3> compute_frame_positions(const Sequence& sequence) {
    std::vector<glm::dvec3> places;
    for (const Frame& frame : sequence.frames)
        places.push_back(sequence.world_from_vehicle.at(frame.time_s).translation);
    return places;
}

bool is_within(const BoxTrack& box, const Sequence& sequence, int position, double metres) {
    const double time_s = sequence.frames[std::size_t(position)].time_s;
    return box.is_present(time_s) &&
           glm::distance(box.world_from_box.at(time_s).translation,
                         sequence.world_from_vehicle.at(time_s).translation) <= metres;
}

}  // namespace relidar
