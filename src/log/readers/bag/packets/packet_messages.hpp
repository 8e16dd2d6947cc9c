// SPDX-License-Identifier: Apache-2.0
// Reads ROS messages that contain LiDAR packets.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "log/readers/bag/messages.hpp"
#include "log/readers/bag/packets/decoder.hpp"

namespace relidar::packets {

/// Message types of the topics that are created from a network capture. A message of the
/// type kDatagrams contains LiDAR packets. For each packet, it has the time stamp (64
/// bits), the length (32 bits) and the bytes. A message of the type kOtherDatagrams
/// contains other datagrams.
inline constexpr const char *kDatagrams = "LiDAR packets", *kOtherDatagrams = "other UDP";

/// Returns true if the messages of a topic contain LiDAR packets. The type of the topic
/// does not always name the product, so the packets must be checked for it.
bool has_packets(const bag::Topic& topic);
/// Returns true for a topic of Ouster's drivers. Its messages contain one packet and no
/// other data.
bool has_ouster_packets(const bag::Topic& topic);
/// Returns true if a topic may contain the metadata of an Ouster. Such a topic contains
/// text and is in the namespace of a sensor with packets.
bool can_be_ouster_metadata(const bag::Topic& topic);
/// Returns the text of a std_msgs/String message.
/// @throws DataError if the message is too short
std::string read_text_message(const bag::Topic& topic, std::string_view bytes);
/// Returns the packets that a message contains.
/// @param log_ns  recording time of the message, used for packets without a time stamp
/// @param header  output: header of the message. If the message has no header, the
/// topic's name is used as the name of the frame.
/// @throws DataError if the message is too short
std::vector<PacketView> read_packets(const bag::Topic& topic, std::string_view bytes, std::int64_t log_ns,
                                     bag::Header& header);

}  // namespace relidar::packets
