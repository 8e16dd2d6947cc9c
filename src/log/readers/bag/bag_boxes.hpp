// SPDX-License-Identifier: Apache-2.0
// Converts the boxes of a recording to tracks in the world frame. The boxes may be given
// in any frame of the recording.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include <relidar/log/sequence.hpp>

#include "log/readers/bag/bag_file.hpp"
#include "log/readers/bag/choose.hpp"
#include "log/readers/bag/survey.hpp"

namespace relidar::bag {

/// Transforms and vehicle poses. The poses of boxes in the world frame are computed from
/// these.
struct BoxPlaces {
    const FrameTree& frames;
    /// vehicle poses; also define the clock of the times and the name of the world frame
    const PoseChoice& poses;
    std::string vehicle;  ///< frame whose poses are known
    std::function<Pose(double)> world_from_vehicle;
    /// True if the recording contains the world poses. A box that is given in the world
    /// frame then needs no transform.
    bool is_world_of_poses = false;
};

struct BoxTracks {
    std::vector<BoxTrack> tracks;
    std::vector<std::string> notes;
};
/// Reads the boxes of a topic and joins the boxes of each object to a track.
/// @param times_s  times of the frames of the log in seconds, ascending. Ignores boxes
/// more than one time step before the first time or after the last time.
BoxTracks read_tracks(const Bag& bag, const BoxTopic& boxes, const BoxPlaces& places,
                      const std::vector<double>& times_s);

}  // namespace relidar::bag
