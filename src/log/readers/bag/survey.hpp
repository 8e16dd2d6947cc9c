// SPDX-License-Identifier: Apache-2.0
// Declares the first pass over a recording. It collects the content of each topic, the
// time and position of each cloud, and all poses.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <relidar/base/progress.hpp>

#include "log/readers/bag/bag_file.hpp"
#include "log/readers/bag/frame_tree.hpp"
#include "log/readers/bag/messages.hpp"
#include "log/readers/bag/packets/packet_log.hpp"
#include "log/readers/bag/turn_parts.hpp"

namespace relidar::bag {

struct TopicStatistics {
    std::size_t n = 0;                       ///< number of messages
    std::int64_t first_ns = 0, last_ns = 0;  ///< recording times of the first and the last message
    std::size_t n_broken = 0;                ///< number of messages of the topic that could not be read
    std::string broken;                      ///< error message of the first message that could not be read
    std::size_t n_left_out = 0;              ///< number of transforms with an invalid pose
    std::string left_out;                    ///< text about the first of them

    double compute_message_rate_hz() const {
        return n > 1 && last_ns > first_ns ? 1e9 * double(n - 1) / double(last_ns - first_ns) : 0.0;
    }
};

struct CloudIndexEntry {
    std::int64_t stamp_ns = 0, log_ns = 0;
    std::uint32_t n_points = 0;
    MessagePosition message_position;
    std::size_t revolution_index = 0;  ///< index in CloudTopic::revolutions; used only for a topic of packets
    /// Partial clouds from which this cloud was composed. Empty if the recorded cloud was
    /// already a full revolution.
    std::vector<RevolutionPart> parts = {};
    /// Time by which the time stamp in the message is larger than `stamp_ns`, because the
    /// clock of the LiDAR was set during the recording.
    std::int64_t correction_ns = 0;

    std::int64_t get_time_ns(LogClock clock) const { return clock == LogClock::stamps ? stamp_ns : log_ns; }
};

/// The clouds of a LiDAR on a topic.
struct CloudTopic {
    std::size_t topic = 0;
    /// What distinguishes this LiDAR from others on the same topic (CloudMessage::lidar).
    /// Empty if the topic has one LiDAR.
    std::string lidar;
    std::string frame;              ///< frame of the first cloud
    std::size_t n_other_frame = 0;  ///< number of clouds that have another frame than the first cloud
    std::string other_frame;        ///< frame of the first of these clouds
    /// For Ouster packets: the frame names (`frame_id`) that Ouster's driver uses for the
    /// clouds that it computes from these packets. Empty for other topics.
    std::vector<std::string> driver_frames;
    std::vector<CloudMessage::CloudField> fields;  ///< fields of the first cloud
    /// Clouds with points, in the order of the recording. Clouds that were parts of a
    /// revolution are already joined.
    std::vector<CloudIndexEntry> clouds;
    std::string parts_about;           ///< text about the joined clouds; empty if no clouds are joined
    std::vector<RevolutionPart> arcs;  ///< used during the survey
    std::size_t n_empty = 0;
    /// Packets of the topic, if it contains packets instead of clouds. Each revolution
    /// then becomes one scan.
    packets::PacketIndex packets;
    std::vector<packets::PacketRevolution> revolutions;

    bool has_field_with_attribute(folder::PointAttribute attribute) const;
    std::size_t compute_median_point_count() const;  ///< Returns the median number of points of a cloud.
    /// Returns the name of the LiDAR: the topic, and `lidar` if it is not empty.
    std::string make_name(const BagRecording& bag) const;
};

struct PoseTopic {
    std::size_t topic = 0;
    std::string parent, child;  ///< names of the parent and the child frame; the child may be empty
    std::vector<StampedPose> samples;
};

/// A message that contains at least one box.
struct BoxIndexEntry {
    std::int64_t stamp_ns = 0, log_ns = 0;
    MessagePosition message_position;
};

struct BoxTopic {
    std::size_t topic = 0;
    std::string frame;  ///< frame of the first box
    std::vector<BoxIndexEntry> lists;
    std::size_t n_boxes = 0, n_named = 0;  ///< number of boxes, and number of boxes that have a track id
    /// number of boxes that are ignored because their size or their pose is invalid
    std::size_t n_left_out = 0;
};

struct BagIndex {
    std::vector<TopicStatistics>
        facts;  ///< message statistics of each topic, in the order of BagRecording::topics()
    std::vector<CloudTopic> clouds;
    std::vector<PoseTopic> poses;
    std::vector<BoxTopic> boxes;
    FrameTree frames;
};

/// Reads all messages of a recording once and lists its content. Invalid messages are
/// counted; they do not cause an error.
/// @throws DataError if a file is damaged
BagIndex index_bag_messages(BagRecording& bag, const ProgressReporter& progress);

}  // namespace relidar::bag
