// SPDX-License-Identifier: Apache-2.0
#include "run/blocks/frame_places.hpp"

namespace relidar {

std::vector<glm::dvec3> compute_vehicle_position_per_frame(const LidarSequence& sequence) {
    std::vector<glm::dvec3> positions_m;
    for (const LidarFrame& frame : sequence.frames)
        positions_m.push_back(sequence.world_from_vehicle.interpolate_pose(frame.time_s).translation);
    return positions_m;
}

bool is_box_within_distance_of_vehicle(const BoxTrack& box, const LidarSequence& sequence, int frame_index,
                                       double max_distance_m) {
    const double time_s = sequence.frames[std::size_t(frame_index)].time_s;
    return box.is_observed_at_time(time_s) &&
           glm::distance(box.world_from_box.interpolate_pose(time_s).translation,
                         sequence.world_from_vehicle.interpolate_pose(time_s).translation) <= max_distance_m;
}

}  // namespace relidar
