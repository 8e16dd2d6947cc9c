// SPDX-License-Identifier: Apache-2.0
// Selects the topics of a recording that are loaded as a log: the clouds of each LiDAR,
// the poses and the boxes. The user's settings override the automatic selection.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "log/readers/bag/clock_offset.hpp"
#include "log/readers/bag/survey.hpp"

namespace relidar::bag {

/// The point cloud topics that are loaded.
struct SelectedCloudTopics {
    std::vector<std::size_t> lidars;  ///< indices in BagIndex::clouds; each LiDAR has a different frame
    /// main LiDAR, as an index in `lidars`; each of its clouds starts a new frame
    std::size_t main = 0;
    std::vector<std::string> notes;
};
/// Selects the point cloud topics to load.
/// @param requested_topics  names of the topics that the user requested; empty: automatic
/// selection
/// @throws DataError if no topic contains clouds
/// @throws UsageError if a requested topic contains no clouds
SelectedCloudTopics choose_cloud_topics(const BagRecording& bag, const BagIndex& bag_index,
                                        const std::vector<std::string>& requested_topics);

/// Removes clouds whose times differ from those of their neighbours on both sides. If the
/// clock of the time stamps jumps, sets all clouds to the clock of the reference, or else
/// to the clock of most clouds. Ignores messages that may only be late.
/// @param reference  messages on the right clock, for example the poses. If their clock
/// jumps at the same time, nothing is corrected. May be empty
/// @return text about the changes, or an empty text
std::string correct_clock_jumps(std::vector<CloudIndexEntry>& clouds, LogClock clock,
                                std::vector<MessageTimes> reference);

/// Which vehicle poses of a bag are used, and which clock gives the times.
struct SelectedPoseSource {
    LogClock clock = LogClock::stamps;
    std::int64_t zero_ns = 0;  ///< time of the first cloud; it becomes 0 s in the log
    /// Time on the clock of the poses that is 0 s in the log. Equals `zero_ns`, unless
    /// the clocks of clouds and poses differ.
    std::int64_t poses_zero_ns = 0;
    /// Pose of the vehicle in the world frame as a function of time. Empty if the bag has
    /// no poses.
    std::optional<TransformChain> path;
    std::string world;       ///< frame in which `path` is expressed
    std::string vehicle;     ///< frame of the vehicle, on which the LiDARs are mounted
    std::string about;       ///< description of the selection
    std::string clock_note;  ///< text about a clock offset between clouds and poses; may be empty
    std::vector<std::string> notes;
};
/// Selects the vehicle poses of the log.
/// @param main_lidar_clouds  clouds of the main LiDAR; poses must cover the times of
/// these clouds. Damaged times are corrected or their clouds removed
/// @param requested_frame_or_topic  name of a frame or of a pose topic; empty: automatic
/// selection
/// @throws UsageError if `requested_frame_or_topic` is neither a frame nor a pose topic
SelectedPoseSource choose_vehicle_pose_source(const BagRecording& bag, const BagIndex& bag_index,
                                              CloudTopic& main_lidar_clouds,
                                              const std::string& requested_frame_or_topic);

struct SelectedBoxTopic {
    const BoxTopic* topic = nullptr;  ///< box topic in BagIndex::boxes, or null
    std::vector<std::string> notes;
};
/// Selects the topic with the most boxes that have a track id. If two topics have the
/// same number, selects the first one by name.
SelectedBoxTopic choose_box_topic(const BagRecording& bag, const BagIndex& bag_index);

}  // namespace relidar::bag
