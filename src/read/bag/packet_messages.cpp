// SPDX-License-Identifier: Apache-2.0
#include "read/bag/packet_messages.hpp"

#include <algorithm>
#include <iterator>

#include "base/codecs/byte_reader.hpp"
#include "base/fail.hpp"

namespace relidar::bag {
namespace {

/// Layout of a packet in a message.
enum class PacketMessageLayout {
    fixed,   ///< a time stamp, then the packet as an array of `n` bytes
    padded,  ///< a time stamp, an array of `n` bytes, then the number of bytes that the packet uses
    list,    ///< a time stamp, then the packet as a list of bytes with a length
    bare,    ///< a time stamp in nanoseconds, then a list of bytes; the message has no header
    alone,   ///< only the bytes of one packet; the message has no header
};
struct PacketMessageType {
    const char* type;
    PacketMessageLayout form;
    std::size_t n = 0;
};
constexpr PacketMessageType kPacketTypes[] = {
    {"velodyne_msgs/VelodyneScan", PacketMessageLayout::fixed, 1206},
    {"pandar_msgs/PandarScan", PacketMessageLayout::padded, 1500},
    {"hesai_lidar/PandarScan", PacketMessageLayout::padded, 1500},
    {"nebula_msgs/NebulaPackets", PacketMessageLayout::list},
    {"ouster_sensor_msgs/PacketMsg", PacketMessageLayout::alone},
    {"ouster_msgs/PacketMsg", PacketMessageLayout::alone},
    {"ouster_ros/PacketMsg", PacketMessageLayout::alone},
    {kLidarDatagrams, PacketMessageLayout::bare},
};
// topics of Ouster's drivers
constexpr std::string_view kImuTopic = "imu_packets", kMetadataTopic = "/metadata";
constexpr std::size_t kImuBytes = 48;

const PacketMessageType* find_type(std::string_view type_name) {
    const auto* matching_type = std::ranges::find(kPacketTypes, type_name, &PacketMessageType::type);
    return matching_type == std::end(kPacketTypes) ? nullptr : matching_type;
}

/// Returns the bytes of a packet that follow its time stamp.
std::string_view read_packet(MessageReader& reader, const PacketMessageType& message_type) {
    if (message_type.form == PacketMessageLayout::list) return reader.read_bytes(reader.read_length(1));
    const std::string_view bytes = reader.read_bytes(message_type.n);
    const std::size_t size = message_type.form == PacketMessageLayout::padded
                                 ? reader.read_number<std::uint32_t>()
                                 : message_type.n;
    if (size > message_type.n) fail("found a packet of {} bytes, expected at most {}", size, message_type.n);
    return bytes.substr(0, size);
}

}  // namespace

bool has_packets(const BagTopic& topic) {
    return find_type(topic.type) != nullptr && !(is_ouster_topic(topic) && topic.name.ends_with(kImuTopic));
}

bool is_ouster_topic(const BagTopic& topic) {
    const PacketMessageType* type = find_type(topic.type);
    return type && type->form == PacketMessageLayout::alone;
}

bool can_have_metadata(const BagTopic& topic) {
    return topic.type == "std_msgs/String" && topic.name.ends_with(kMetadataTopic);
}

PacketMessage read_packets(const BagTopic& topic, std::string_view message_bytes,
                           std::int64_t recording_time_ns) {
    const PacketMessageType& type = *find_type(topic.type);
    PacketMessage message{.frame = topic.name, .packets = {}};
    if (type.form == PacketMessageLayout::bare) {
        for (codecs::ByteReader reader(message_bytes); reader.remaining() > 0;) {
            const auto stamp_ns = reader.read_number<std::int64_t>();
            message.packets.push_back({stamp_ns, reader.read_string()});
        }
        return message;
    }
    MessageReader reader(topic, message_bytes);
    if (type.form == PacketMessageLayout::alone) {
        const std::string_view packet = reader.read_bytes(reader.read_length(1));
        // Packets of the IMU have the same message type and are skipped.
        if (packet.size() != kImuBytes) message.packets.push_back({recording_time_ns, packet});
        return message;
    }
    message.frame = read_header(reader).frame;
    constexpr std::size_t kTimeBytes = 8;
    const std::size_t n = reader.read_length(kTimeBytes + type.n);
    for (std::size_t i = 0; i < n; ++i) {
        const std::int64_t stamp_ns = read_time_ns(reader);
        message.packets.push_back({stamp_ns, read_packet(reader, type)});
    }
    return message;
}

}  // namespace relidar::bag
