// SPDX-License-Identifier: Apache-2.0
// Converts the boxes of a recording to tracks in the world frame. A message may store
// boxes in any coordinate frame of the recording.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include <relidar/log/sequence.hpp>

#include "log/readers/bag/bag_file.hpp"
#include "log/readers/bag/choose.hpp"
#include "log/readers/bag/survey.hpp"

namespace relidar::bag {

/// Transforms and vehicle poses that are needed to convert boxes to the world frame.
struct BoxTransformContext {
    const FrameTree& frames;
    /// vehicle poses, name of the world frame, and clock of the log
    const SelectedPoseSource& poses;
    std::string vehicle;  ///< frame whose poses are known
    std::function<Pose(double)> world_from_vehicle;
    std::int64_t box_zero_ns = 0;  ///< time on the clock of the boxes that is 0 s in the log
    /// True if the vehicle poses were read from the bag. The frame `poses.world` is then
    /// the world frame of the log, so boxes in it need no transform.
    bool is_world_of_poses = false;
};

struct LoadedBoxTracks {
    std::vector<BoxTrack> tracks;
    std::vector<std::string> notes;
};
/// Reads the boxes of a topic and joins the boxes of each object to a track. Accepts
/// times up to one time step before the first or after the last frame.
/// @param frame_times_s  times of the frames of the log in seconds, ascending
LoadedBoxTracks read_box_tracks_from_bag(const BagRecording& bag, const BoxTopic& box_topic,
                                         const BoxTransformContext& transform_context,
                                         const std::vector<double>& frame_times_s);

}  // namespace relidar::bag
