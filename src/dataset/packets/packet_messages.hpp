// SPDX-License-Identifier: Apache-2.0
// Messages of ROS that carry packets.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "dataset/bag/messages.hpp"
#include "dataset/packets/decoder.hpp"

namespace relidar::packets {

/// Whether messages of a type carry packets; packets of what, is seen in them.
bool carries_packets(std::string_view type);
/// What such a message holds. @param log_ns  when it was recorded: the stamp of packets without one @param header  of the message, or the
/// frame that the driver gives the sensor where it has none
/// @throws DataError where the message ends too early
std::vector<PacketView> read_packets(const bag::Topic& topic, std::string_view bytes, std::int64_t log_ns, bag::Header& header);

}  // namespace relidar::packets
