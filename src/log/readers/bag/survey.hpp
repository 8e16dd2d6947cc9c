// SPDX-License-Identifier: Apache-2.0
// First pass over a recording. Collects the content of each topic, the time and position
// of each cloud, and all poses.
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

struct TopicFacts {
    std::size_t n = 0;                       ///< number of messages
    std::int64_t first_ns = 0, last_ns = 0;  ///< recording times of the first and the last message
    std::size_t n_broken = 0;                ///< number of messages that could not be read
    std::string broken;                      ///< problem of the first of them

    double rate_hz() const {
        return n > 1 && last_ns > first_ns ? 1e9 * double(n - 1) / double(last_ns - first_ns) : 0.0;
    }
};

struct CloudEntry {
    std::int64_t stamp_ns = 0, log_ns = 0;
    std::uint32_t n_points = 0;
    Place place;
    std::size_t turn = 0;  ///< for a topic of packets: index in CloudTopic::turns
    /// Parts of the revolution, if several clouds form one revolution. Empty: this cloud
    /// is a full revolution.
    std::vector<TurnPart> parts = {};

    std::int64_t time_ns(Clock clock) const { return clock == Clock::stamps ? stamp_ns : log_ns; }
};

struct CloudTopic {
    std::size_t topic = 0;
    std::string frame;  ///< frame of the first cloud
    /// For packets: names of the frames in which drivers publish the clouds that they
    /// compute from these packets.
    std::vector<std::string> driver_frames;
    std::vector<Cloud::Field> fields;  ///< fields of the first cloud
    /// Clouds that have points, in recording order. If clouds are parts of revolutions,
    /// these are the joined revolutions.
    std::vector<CloudEntry> clouds;
    std::string parts_about;     ///< description of the parts; empty if clouds are not joined
    std::vector<TurnPart> arcs;  ///< used during the survey
    std::size_t n_empty = 0;
    packets::PacketLog packets;  ///< for a topic of packets, whose revolutions are its clouds
    std::vector<packets::PacketTurn> turns;

    bool has_field(folder::PointValue value) const;
    std::size_t usual_points() const;  ///< median number of points of a cloud
};

struct PoseTopic {
    std::size_t topic = 0;
    std::string parent, child;  ///< frames; the child may be empty
    std::vector<PoseSample> samples;
};

/// A message that contains at least one box.
struct BoxEntry {
    std::int64_t stamp_ns = 0, log_ns = 0;
    Place place;
};

struct BoxTopic {
    std::size_t topic = 0;
    std::string frame;  ///< frame of the first box
    std::vector<BoxEntry> lists;
    std::size_t n_boxes = 0, n_named = 0;  ///< number of boxes; number of boxes that have an id
    std::size_t n_left_out = 0;            ///< boxes without a size or a pose
};

struct Survey {
    std::vector<TopicFacts> facts;  ///< facts of each topic, in the order of Bag::topics()
    std::vector<CloudTopic> clouds;
    std::vector<PoseTopic> poses;
    std::vector<BoxTopic> boxes;
    FrameTree frames;
};

/// Reads all messages of a recording once and collects its content. Invalid messages are
/// only counted.
/// @throws DataError if a file is damaged
Survey survey_bag(Bag& bag, const Progress& progress);

}  // namespace relidar::bag
