// SPDX-License-Identifier: Apache-2.0
// Messages of ROS that carry packets.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "dataset/bag/messages.hpp"
#include "dataset/packets/decoder.hpp"

namespace relidar::packets {

/// Type of topics of a capture that carry packets: stamp (64 bits), length (32 bits) and bytes of each. And of one that carries Hesai's
/// angle correction, a text.
inline constexpr const char *kDatagrams = "LiDAR packets", *kCorrection = "angle correction";

/// Whether messages of a type carry packets; packets of what, is seen in them.
bool carries_packets(std::string_view type);
/// What such a message holds. @param header  of the message; the frame of a capture's is its topic
/// @throws DataError where the message ends too early
std::vector<PacketView> read_packets(const bag::Topic& topic, std::string_view bytes, bag::Header& header);

}  // namespace relidar::packets
