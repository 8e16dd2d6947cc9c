// SPDX-License-Identifier: Apache-2.0
// Converts the boxes of a recording from any frame to tracks in the world frame.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include <relidar/log/sequence.hpp>

#include "log/readers/bag/bag_file.hpp"
#include "log/readers/bag/choose.hpp"
#include "log/readers/bag/survey.hpp"

namespace relidar::bag {

/// Transforms and poses that locate the frames of boxes.
struct BoxPlaces {
    const FrameTree& frames;
    const PoseChoice& poses;  ///< their clock, and the frame of the world
    std::string vehicle;      ///< frame whose poses are known
    std::function<Pose(double)> world_from_vehicle;
    /// True if the poses come from the recording. Boxes in the world frame then need no
    /// transform.
    bool is_own_world = false;
};

struct BoxTracks {
    std::vector<BoxTrack> tracks;
    std::vector<std::string> notes;
};
/// Reads the tracks of a topic.
/// @param times_s  ascending times of the log; boxes more than one step outside are
/// ignored
BoxTracks read_tracks(const Bag& bag, const BoxTopic& boxes, const BoxPlaces& places,
                      const std::vector<double>& times_s);

}  // namespace relidar::bag
