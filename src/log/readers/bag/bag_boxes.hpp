// SPDX-License-Identifier: Apache-2.0
// Boxes of a recording, in whatever frame, as tracks in the world.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include <relidar/log/sequence.hpp>

#include "log/readers/bag/bag_file.hpp"
#include "log/readers/bag/choose.hpp"
#include "log/readers/bag/survey.hpp"

namespace relidar::bag {

/// Where the frames of boxes are.
struct BoxPlaces {
    const FrameTree& frames;
    const PoseChoice& poses;  ///< their clock, and the frame that is the world
    std::string vehicle;      ///< frame of which the poses are known
    std::function<Pose(double)> world_from_vehicle;
    /// poses are the recording's own: boxes in the world's frame are there already
    bool is_own_world = false;
};

struct BoxTracks {
    std::vector<BoxTrack> tracks;
    std::vector<std::string> notes;
};
/// @param times_s  ascending, of the log: boxes more than a step beside them are left out
BoxTracks read_tracks(const Bag& bag, const BoxTopic& boxes, const BoxPlaces& places,
                      const std::vector<double>& times_s);

}  // namespace relidar::bag
