// SPDX-License-Identifier: Apache-2.0
// Reads ROS messages that contain LiDAR packets.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "read/bag/messages.hpp"
#include "read/packets/decoder.hpp"

namespace relidar::bag {

/// Types of the topics that are made from a network capture. A message of type
/// kLidarDatagrams contains several LiDAR packets, each with a time stamp (64 bits), a
/// length (32 bits) and its bytes. Messages of type kOtherDatagrams contain other UDP
/// data.
inline constexpr const char *kLidarDatagrams = "LiDAR packets", *kOtherDatagrams = "other UDP";

/// Returns true if the message type of a topic contains LiDAR packets of any product.
bool has_packets(const BagTopic& topic);
/// Returns true for a topic of Ouster's ROS drivers, whose messages are single packets.
bool is_ouster_topic(const BagTopic& topic);
/// Returns true if a topic contains text and is in the namespace of a topic with packets.
/// The text can be Ouster metadata.
bool can_have_metadata(const BagTopic& topic);

struct PacketMessage {
    std::string frame;                             ///< the topic's name if the message has no header
    std::vector<packets::ReceivedPacket> packets;  ///< views of the message
};
/// Reads the LiDAR packets of a message.
/// @param recording_time_ns  used for packets without a time stamp
/// @throws DataError if the message is too short
PacketMessage read_packets(const BagTopic& topic, std::string_view message_bytes,
                           std::int64_t recording_time_ns);

}  // namespace relidar::bag
