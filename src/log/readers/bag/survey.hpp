// SPDX-License-Identifier: Apache-2.0
// The first pass over a recording: what each topic holds, when each cloud was measured
// and where it lies, and all poses.
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
    std::size_t n = 0;                       ///< messages
    std::int64_t first_ns = 0, last_ns = 0;  ///< recorded
    std::size_t n_broken = 0;                ///< of those that are read
    std::string broken;                      ///< what the first of them has

    double rate_hz() const {
        return n > 1 && last_ns > first_ns ? 1e9 * double(n - 1) / double(last_ns - first_ns) : 0.0;
    }
};

struct CloudEntry {
    std::int64_t stamp_ns = 0, log_ns = 0;
    std::uint32_t n_points = 0;
    Place place;
    std::size_t turn = 0;              ///< of a topic of packets: in CloudTopic::turns
    std::vector<TurnPart> parts = {};  ///< of a turn that several clouds make; none: this cloud alone

    std::int64_t time_ns(Clock clock) const { return clock == Clock::stamps ? stamp_ns : log_ns; }
};

struct CloudTopic {
    std::size_t topic = 0;
    std::string frame;  ///< of the first cloud
    /// of packets: in which drivers put the clouds that they make of them
    std::vector<std::string> frames_beside;
    std::vector<Cloud::Field> fields;  ///< of the first cloud
    /// that have points, as they were recorded; or whole turns of their parts
    std::vector<CloudEntry> clouds;
    std::string parts_about;     ///< of clouds that are parts of turns: what they are
    std::vector<TurnPart> arcs;  ///< while the recording is surveyed
    std::size_t n_empty = 0;
    packets::PacketLog packets;  ///< of a topic of packets, whose turns are its clouds
    std::vector<packets::PacketTurn> turns;

    bool has_field(folder::PointValue value) const;
    std::size_t usual_points() const;  ///< of a cloud: the median
};

struct PoseTopic {
    std::size_t topic = 0;
    std::string parent, child;  ///< frames; the child may be empty
    std::vector<PoseSample> samples;
};

/// A list of boxes that has some.
struct BoxEntry {
    std::int64_t stamp_ns = 0, log_ns = 0;
    Place place;
};

struct BoxTopic {
    std::size_t topic = 0;
    std::string frame;  ///< of the first box
    std::vector<BoxEntry> lists;
    std::size_t n_boxes = 0, n_named = 0;  ///< and of them: with an identity
    std::size_t n_left_out = 0;            ///< without a size or a pose
};

struct Survey {
    std::vector<TopicFacts> facts;  ///< [Bag::topics()]
    std::vector<CloudTopic> clouds;
    std::vector<PoseTopic> poses;
    std::vector<BoxTopic> boxes;
    FrameTree frames;
};

/// @throws DataError for a file that is damaged; a message that is, is counted
Survey take_survey(Bag& bag, const Progress& progress);

}  // namespace relidar::bag
