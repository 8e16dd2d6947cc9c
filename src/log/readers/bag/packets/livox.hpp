// SPDX-License-Identifier: Apache-2.0
// Decodes packets of Livox sensors with the protocol of Livox SDK2 (Mid-360, HAP). These
// sensors do not spin, so the packets of 0.1 s form a cloud, as in Livox's driver.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

namespace relidar::packets {

/// Encoding and type of the clouds that livox_cloud() returns.
inline constexpr const char *kLivoxEncoding = "ros1", *kLivoxType = "livox_ros_driver2/CustomMsg";
/// A cloud is complete when its packets span this time. The next cloud then starts about
/// 0.1 s after this cloud.
inline constexpr std::int64_t kLivoxCloud_ns = 99'000'000;
inline constexpr std::size_t kMostLivoxPackets = 4096;  ///< maximum number of packets in a cloud

/// Returns true if the bytes are a packet with points. Packets of the IMU have no points.
bool is_livox(std::string_view bytes);

/// Returns the cloud of a list of packets, as a message of the driver in the encoding of
/// ROS 1. Rays without a return have the coordinates (0, 0, 0) in a packet and are left
/// out, because their directions are unknown.
/// @param packets  packets: for each packet its stamp (64 bits), length (32 bits) and
/// bytes
/// @param frame  name of the frame of the cloud
/// @throws DataError if the list is damaged
std::string livox_cloud(std::string_view packets, std::string_view frame);

}  // namespace relidar::packets
