// SPDX-License-Identifier: Apache-2.0
// Decodes packets of Livox sensors that use the protocol of Livox SDK2 (Mid-360, HAP).
// These sensors do not rotate. As in Livox's driver, the packets of 0.1 s form one cloud.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

namespace relidar::packets {

/// Encoding and message type of the clouds that make_livox_cloud_message() returns.
inline constexpr const char *kLivoxEncoding = "ros1", *kLivoxType = "livox_ros_driver2/CustomMsg";
/// Duration of a cloud that is composed of packets. It is slightly below 0.1 s, so that a
/// new cloud starts about every 0.1 s.
inline constexpr std::int64_t kLivoxCloud_ns = 99'000'000;
inline constexpr std::size_t kMostLivoxPackets = 4096;  ///< maximum number of packets in one cloud

/// Returns true if the bytes are a Livox packet with points. Returns false for packets of
/// the IMU.
bool is_livox_point_packet(std::string_view packet_bytes);

/// Joins packets to a cloud. Returns the cloud as a message of Livox's driver in the
/// encoding of ROS 1. Omits rays without a return, because packets do not contain the
/// directions of these rays.
/// @param packed_packets  for each packet: time stamp (64 bits), length (32 bits) and
/// bytes
/// @param frame_id  name of the frame of the cloud
/// @throws DataError if the list of packets is damaged
std::string make_livox_cloud_message(std::string_view packed_packets, std::string_view frame_id);

}  // namespace relidar::packets
