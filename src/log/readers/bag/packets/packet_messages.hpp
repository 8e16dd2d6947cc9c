// SPDX-License-Identifier: Apache-2.0
// ROS messages that contain LiDAR packets.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "log/readers/bag/messages.hpp"
#include "log/readers/bag/packets/decoder.hpp"

namespace relidar::packets {

/// Types of two topics of a network capture. The first has packets: stamp (64 bits),
/// length (32 bits) and bytes of each. The second has Hesai's angle correction as text.
inline constexpr const char *kDatagrams = "LiDAR packets", *kCorrection = "angle correction";

/// Returns true if messages of a topic contain LiDAR packets. The product is determined
/// from the packets.
bool carries_packets(const bag::Topic& topic);
/// Returns true if the messages are those of Ouster's drivers, which contain a single
/// packet and nothing else.
bool carries_ouster_packets(const bag::Topic& topic);
/// Returns true if messages of a topic may be the metadata of an Ouster: a text in the
/// namespace of a sensor with packets.
bool may_be_ouster_metadata(const bag::Topic& topic);
/// Returns the text of std_msgs/String.
/// @throws DataError if the message is too short
std::string read_text_message(const bag::Topic& topic, std::string_view bytes);
/// Returns the packets of a message.
/// @param log_ns  recording time, used as the stamp of packets without a stamp
/// @param header  output: header of the message; without a header, as in a capture, the
/// frame is the topic
/// @throws DataError if the message is too short
std::vector<PacketView> read_packets(const bag::Topic& topic, std::string_view bytes, std::int64_t log_ns,
                                     bag::Header& header);

}  // namespace relidar::packets
