// SPDX-License-Identifier: Apache-2.0
// Selects the topics of a recording that are loaded as a log: the clouds of each LiDAR,
// the poses and the boxes. The user's settings override the automatic selection.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <relidar/read/dataset.hpp>

#include "read/bag/survey.hpp"

namespace relidar::bag {

/// Returns the times of messages. Ignores messages without a time stamp.
template <class Entries>
std::vector<MessageTimes> list_times(const Entries& entries) {
    std::vector<MessageTimes> times;
    for (const MessageTimes& entry : entries)
        if (entry.stamp_ns != 0) times.push_back(entry);
    return times;
}

/// Returns true for usual names of world frames. Clouds in such a frame are maps, not
/// scans.
inline bool is_world_frame(std::string_view frame) {
    return frame == "map" || frame == "odom" || frame == "world" || frame == "earth";
}

/// Returns true for usual names of the vehicle frame. Clouds in this frame are usually
/// merged from several sensors.
inline bool is_vehicle_frame(std::string_view frame) {
    return frame == "base_link" || frame == "base_footprint" || frame == "vehicle" || frame == "ego";
}

struct ClockOffset {
    std::int64_t offset_ns = 0;  ///< 0 if the time stamps may come from one clock
    /// Change of the offset from the begin to the end of the recording. 0 if it is small.
    std::int64_t drift_ns = 0;
    /// True if the offset is certain. Otherwise, late messages are also possible.
    bool is_clear = false;

    std::int64_t correction_ns() const { return is_clear ? offset_ns : 0; }
    /// Returns the offset with its usual cause, for example "37.000 s ahead of the time
    /// stamps of the poses (TAI minus UTC is 37 s)".
    std::string describe(const std::string& reference_name) const;
};

/// Compares two kinds of messages by their time stamps minus their recording times.
/// Delays of some hundred milliseconds and unrelated recording times give no offset.
/// @return time by which the clock of `messages` is ahead of the clock of `reference`
ClockOffset estimate_offset(const std::vector<MessageTimes>& messages, std::vector<MessageTimes> reference);

/// The point cloud topics that are loaded.
struct ChosenClouds {
    std::vector<std::size_t> lidars;  ///< indices in BagIndex::clouds; each LiDAR has a different frame
    /// main LiDAR, as an index in `lidars`; each of its clouds starts a new frame
    std::size_t main = 0;
    std::vector<std::string> notes;
};
/// Selects the topics whose clouds are loaded, one for each LiDAR, and the main LiDAR.
/// @param requested_topics  names of topics; empty: automatic selection
/// @throws DataError if no topic contains clouds
/// @throws UsageError if a requested topic contains no clouds, or without a request, if
/// topics of one frame are of the same kind
ChosenClouds choose_clouds(const BagRecording& bag, const BagIndex& index,
                           const std::vector<std::string>& requested_topics);

/// Removes clouds whose times differ from those of their neighbours on both sides. If the
/// clock of the time stamps jumps, sets all clouds to the clock of the reference, or else
/// to the clock of most clouds. Ignores messages that may only be late.
/// @param reference  messages on the right clock, for example the poses. If their clock
/// jumps at the same time, nothing is corrected. May be empty
/// @return text about the changes, or an empty text
std::string fix_clock_jumps(std::vector<CloudEntry>& clouds, LogClock clock,
                            std::vector<MessageTimes> reference);

/// Which vehicle poses of a bag are used, and which clock gives the times.
struct ChosenPoses {
    LogClock clock = LogClock::stamps;
    std::int64_t zero_ns = 0;  ///< time of the first cloud, which is 0 s in the log
    /// the same on the clock of the poses
    std::int64_t poses_zero_ns = 0;
    /// Pose of the vehicle in the world frame. Empty if the bag has no poses.
    std::optional<TransformChain> path;
    std::string world;        ///< frame in which `path` is expressed
    std::string vehicle;      ///< frame of the vehicle, on which the LiDARs are mounted
    std::string description;  ///< text about the selected source for the user
    std::string clock_note;   ///< text about an offset between clouds and poses that is not corrected
    std::vector<UsedConvention> conventions;  ///< of the poses
    bool is_inverse = false;                  ///< true: the recording has the inverse of the poses
    std::vector<std::string> notes;
};
/// Selects the source of the vehicle poses and the clock of the log.
/// @param main_lidar_clouds  the poses must cover their times. Damaged times are
/// corrected or their clouds removed
/// @param options  bag.poses_from is a frame or pose topic; empty: automatic selection
/// @throws UsageError if this is neither a frame nor a pose topic, or if several topics
/// of the same kind have poses
ChosenPoses choose_poses(const BagRecording& bag, const BagIndex& index, CloudTopic& main_lidar_clouds,
                         const DatasetOptions& options);

/// Fits the path of the vehicle, which must be known, to positions on the earth.
GeoreferenceFit find_place(const FixTopic& fixes, const ChosenPoses& poses, const FrameTree& frames);

struct SelectedBoxTopic {
    const BoxTopic* topic = nullptr;  ///< box topic in BagIndex::boxes, or null
    std::vector<std::string> notes;
};
/// Selects the topic with the most boxes that have a track id. If two topics have the
/// same number, selects the first one by name.
SelectedBoxTopic choose_boxes(const BagRecording& bag, const BagIndex& index);

/// What is needed to place boxes in the log.
struct BoxContext {
    const FrameTree& frames;
    const ChosenPoses& poses;
    std::string vehicle;  ///< frame whose poses are known
    std::function<Pose(double)> world_from_vehicle;
    std::int64_t box_zero_ns = 0;  ///< time on the clock of the boxes that is 0 s in the log
    /// True if the vehicle poses were read from the bag, so that `poses.world` is the
    /// world frame of the log.
    bool is_world_of_poses = false;
};

struct LoadedBoxes {
    std::vector<BoxTrack> tracks;
    std::vector<std::string> notes;
};
/// Reads the boxes of a topic and joins the boxes of each object to a track. Accepts
/// times up to one time step before the first or after the last frame.
/// @param times_s  times of the frames of the log in seconds, ascending
LoadedBoxes read_bag_boxes(const BagRecording& bag, const BoxTopic& box_topic, const BoxContext& context,
                           const std::vector<double>& times_s);

}  // namespace relidar::bag
