// SPDX-License-Identifier: Apache-2.0
#include "log/readers/bag/packets/packet_messages.hpp"

#include <algorithm>
#include <iterator>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/codecs/byte_reader.hpp"
#include "log/readers/bag/message_reader.hpp"

namespace relidar::packets {
namespace {

using bag::MessageReader;

/// Layout of a packet in a message.
enum class Form {
    fixed,   ///< a time stamp, then the packet as an array of `n` bytes
    padded,  ///< a time stamp, an array of `n` bytes, then the number of bytes that the packet uses
    list,    ///< a time stamp, then the packet as a list of bytes with a length
    bare,    ///< a time stamp in nanoseconds, then a list of bytes; the message has no header
    alone,   ///< only the bytes of one packet; the message has no header
};
struct MessageType {
    const char* type;
    Form form;
    std::size_t n = 0;
};
constexpr MessageType kTypes[] = {
    {"velodyne_msgs/VelodyneScan", Form::fixed, 1206},
    {"pandar_msgs/PandarScan", Form::padded, 1500},
    {"hesai_lidar/PandarScan", Form::padded, 1500},
    {"nebula_msgs/NebulaPackets", Form::list},
    {"ouster_sensor_msgs/PacketMsg", Form::alone},
    {"ouster_msgs/PacketMsg", Form::alone},
    {"ouster_ros/PacketMsg", Form::alone},
    {kDatagrams, Form::bare},
};
// topics of Ouster's drivers
constexpr std::string_view kImuTopic = "imu_packets", kMetadataTopic = "/metadata";
constexpr std::size_t kImuBytes = 48;

const MessageType* find_type(std::string_view type) {
    const auto* known =
        std::ranges::find_if(kTypes, [&](const MessageType& row) { return type == row.type; });
    return known == std::end(kTypes) ? nullptr : known;
}

std::string_view read_bytes(MessageReader& reader, const MessageType& type) {
    if (type.form == Form::list) return reader.take(reader.length(1));
    const std::string_view bytes = reader.take(type.n);
    const std::size_t size = type.form == Form::padded ? reader.number<std::uint32_t>() : type.n;
    if (size > type.n)
        throw DataError(fmt::format("found a packet of {} bytes, expected at most {}", size, type.n));
    return bytes.substr(0, size);
}

}  // namespace

bool has_packets(const bag::Topic& topic) {
    return find_type(topic.type) != nullptr &&
           !(has_ouster_packets(topic) && topic.name.ends_with(kImuTopic));
}

bool has_ouster_packets(const bag::Topic& topic) {
    const MessageType* type = find_type(topic.type);
    return type && type->form == Form::alone;
}

bool can_be_ouster_metadata(const bag::Topic& topic) {
    return topic.type == "std_msgs/String" && topic.name.ends_with(kMetadataTopic);
}

std::string read_text_message(const bag::Topic& topic, std::string_view bytes) {
    return std::string(MessageReader(bytes, topic.encoding == "ros1").text());
}

std::vector<PacketView> read_packets(const bag::Topic& topic, std::string_view bytes, std::int64_t log_ns,
                                     bag::Header& header) {
    const MessageType& type = *find_type(topic.type);
    std::vector<PacketView> packets;
    if (type.form == Form::alone) {
        header = {log_ns, topic.name};
        MessageReader reader(bytes, topic.encoding == "ros1");
        const std::string_view packet = reader.take(reader.length(1));
        if (packet.size() != kImuBytes) packets.push_back({log_ns, packet});
        return packets;
    }
    if (type.form == Form::bare) {
        header = {0, topic.name};
        for (bag::ByteReader reader(bytes); reader.left() > 0;) {
            const auto stamp_ns = reader.number<std::int64_t>();
            packets.push_back({stamp_ns, reader.read_sized_string()});
        }
        return packets;
    }
    MessageReader reader(bytes, topic.encoding == "ros1");
    header = read_header(reader);
    const std::size_t n = reader.length(8 + type.n);
    for (std::size_t i = 0; i < n; ++i) {
        const std::int64_t stamp_ns = read_time(reader);
        packets.push_back({stamp_ns, read_bytes(reader, type)});
    }
    return packets;
}

}  // namespace relidar::packets
