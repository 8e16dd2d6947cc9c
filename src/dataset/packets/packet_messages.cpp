// SPDX-License-Identifier: Apache-2.0
#include "dataset/packets/packet_messages.hpp"

#include <algorithm>
#include <iterator>

#include <fmt/format.h>

#include <relidar/error.hpp>

#include "dataset/bag/message_reader.hpp"

namespace relidar::packets {
namespace {

using bag::MessageReader;

constexpr const char* kOusterFrame = "os_sensor";  // as its driver names it

/// How the bytes of a packet lie in a message.
enum class Form {
    fixed,   ///< stamp, `n` bytes
    padded,  ///< stamp, `n` bytes, how many of them are the packet's
    list,    ///< stamp, a list of bytes
    bare,    ///< the message is one list of bytes: no header, no stamp
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
    {"ouster_ros/PacketMsg", Form::bare},
    {"ouster_msgs/PacketMsg", Form::bare},
    {"ouster_sensor_msgs/PacketMsg", Form::bare},
};

const MessageType* find_type(std::string_view type) {
    const auto* known = std::ranges::find_if(kTypes, [&](const MessageType& row) { return type == row.type; });
    return known == std::end(kTypes) ? nullptr : known;
}

std::string_view read_bytes(MessageReader& reader, const MessageType& type) {
    if (type.form == Form::list || type.form == Form::bare) return reader.take(reader.length(1));
    const std::string_view bytes = reader.take(type.n);
    const std::size_t size = type.form == Form::padded ? reader.number<std::uint32_t>() : type.n;
    if (size > type.n) throw DataError(fmt::format("a packet of {} bytes, expected at most {}", size, type.n));
    return bytes.substr(0, size);
}

}  // namespace

bool carries_packets(std::string_view type) {
    return find_type(type) != nullptr;
}

std::vector<PacketView> read_packets(const bag::Topic& topic, std::string_view bytes, std::int64_t log_ns, bag::Header& header) {
    const MessageType& type = *find_type(topic.type);
    MessageReader reader(bytes, topic.encoding == "ros1");
    if (type.form == Form::bare) {
        header = {log_ns, kOusterFrame};
        return {{log_ns, read_bytes(reader, type)}};
    }
    header = read_header(reader);
    std::vector<PacketView> packets;
    const std::size_t n = reader.length(8 + type.n);
    for (std::size_t i = 0; i < n; ++i) {
        const std::int64_t stamp_ns = read_time(reader);
        packets.push_back({stamp_ns, read_bytes(reader, type)});
    }
    return packets;
}

}  // namespace relidar::packets
