// SPDX-License-Identifier: Apache-2.0
#include "run/blocks/frame_places.hpp"

namespace relidar {

std::vector<glm::dvec3> list_positions(const Log& sequence) {
    std::vector<glm::dvec3> positions_m;
    for (const Frame& frame : sequence.frames)
        positions_m.push_back(sequence.world_from_vehicle.pose_at(frame.time_s).translation);
    return positions_m;
}

bool is_near_box(const BoxTrack& box, const Log& sequence, int frame_index, double max_distance_m) {
    const double time_s = sequence.frames[std::size_t(frame_index)].time_s;
    return box.is_observed(time_s) &&
           glm::distance(box.world_from_box.pose_at(time_s).translation,
                         sequence.world_from_vehicle.pose_at(time_s).translation) <= max_distance_m;
}

}  // namespace relidar
