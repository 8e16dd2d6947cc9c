// SPDX-License-Identifier: Apache-2.0
// Messages of ROS that carry packets.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "log/readers/bag/messages.hpp"
#include "log/readers/bag/packets/decoder.hpp"

namespace relidar::packets {

/// Type of topics of a capture that carry packets: stamp (64 bits), length (32 bits) and
/// bytes of each. And of one that carries Hesai's angle correction, a text.
inline constexpr const char *kDatagrams = "LiDAR packets", *kCorrection = "angle correction";

/// Whether messages of a topic carry packets of a LiDAR; of which, is seen in them.
bool carries_packets(const bag::Topic& topic);
/// Whether they are those of Ouster's drivers: a packet each and nothing else.
bool carries_ouster_packets(const bag::Topic& topic);
/// Whether messages of a topic may be the metadata of an Ouster: a text, of a sensor
/// whose packets are in the same name space.
bool may_be_ouster_metadata(const bag::Topic& topic);
/// The text of std_msgs/String. @throws DataError where the message ends too early
std::string read_text_message(const bag::Topic& topic, std::string_view bytes);
/// What a message of packets holds. @param log_ns  when it was recorded: the stamp of
/// packets that have none
/// @param header  of the message; where it has none, as in a capture, the frame is its
/// topic
/// @throws DataError where the message ends too early
std::vector<PacketView> read_packets(const bag::Topic& topic, std::string_view bytes, std::int64_t log_ns,
                                     bag::Header& header);

}  // namespace relidar::packets
