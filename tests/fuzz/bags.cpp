// SPDX-License-Identifier: Apache-2.0
// ROS recordings: full files of each format, and single messages.
#include "harness.hpp"

#include <relidar/read/dataset.hpp>

#include "base/bytes.hpp"
#include "base/codecs/byte_reader.hpp"
#include "base/list_text.hpp"
#include "read/bag/packet_messages.hpp"
#include "read/packets/ouster.hpp"
#include "read/packets/packet_log.hpp"

namespace relidar::fuzz {
namespace {

namespace fs = std::filesystem;

template <class Name>
void read_bag(std::string_view input, const fs::path& folder, Name name) {
    put(folder / name, input);
    load_log("rosbag:" + (folder / name).string(), {});
}
void read_mcap(std::string_view input, const fs::path& folder) { read_bag(input, folder, "input.mcap"); }
void read_ros1(std::string_view input, const fs::path& folder) { read_bag(input, folder, "input.bag"); }
void read_db3(std::string_view input, const fs::path& folder) { read_bag(input, folder, "input.db3"); }

void read_turns(packets::PacketIndex& log, const std::vector<packets::ReceivedPacket>& views) {
    if (log.empty()) return;
    log.finish();
    log.describe_faults();
    const SpinningSensor sensor = log.make_sensor();
    for (const packets::PacketRevolution& revolution : log.revolutions())
        log.decode(revolution, std::vector(log.messages_of(revolution).size(), views), sensor,
                   revolution.forward_ns);
}

/// The first byte of an input is a flag for ROS 1 and the message type.
void read_message(std::string_view input, const fs::path&) {
    static const std::vector<std::string> kMessages = split_list(
        "sensor_msgs/PointCloud2, tf2_msgs/TFMessage, velodyne_msgs/VelodyneScan, "
        "livox_ros_driver2/CustomMsg, nav_msgs/Odometry, geometry_msgs/PoseStamped, foxglove.PointCloud, "
        "foxglove.FrameTransforms, foxglove.SceneUpdate, vision_msgs/Detection3DArray, "
        "autoware_perception_msgs/TrackedObjects, nebula_msgs/NebulaPackets, pandar_msgs/PandarScan, "
        "ouster_ros/PacketMsg, std_msgs/String");
    if (input.empty()) return;
    const unsigned kind = static_cast<unsigned char>(input[0]);
    const std::size_t type = kind / 2 % kMessages.size();
    const std::string topic_type = kMessages[type];
    const char* encoding = kind % 2 ? "ros1" : "cdr";
    if (topic_type.starts_with("foxglove.")) encoding = "protobuf";
    const bag::BagTopic topic{"/t", topic_type, encoding};
    const std::string_view bytes = input.substr(1);
    if (bag::find_purpose(topic) == bag::MessagePurpose::cloud) {
        const SharedBytes message = share_bytes(std::string(bytes));
        bag::to_point_table(bag::read_cloud(topic, message.bytes), message);
    } else if (bag::find_purpose(topic) == bag::MessagePurpose::packets) {
        packets::PacketIndex log;
        const std::vector<packets::ReceivedPacket> views = bag::read_packets(topic, bytes, 0).packets;
        for (int k = 0; k < 2; ++k) log.add_packets(views, 0, {}, {});
        read_turns(log, views);
    } else if (bag::find_purpose(topic) == bag::MessagePurpose::boxes) {
        bag::read_boxes(topic, bytes);
    } else if (topic_type == "std_msgs/String") {
        bag::MessageReader(topic, bytes).read_string();
    } else {
        bag::read_transforms(topic, bytes);
    }
}

/// An input is the length of the metadata, the metadata, and packets.
void read_ousters(std::string_view input, const fs::path&) {
    constexpr std::size_t kMostPackets = 64;
    codecs::ByteReader reader(input);
    packets::DecoderCalibration calibration;
    calibration.ouster = packets::parse_metadata(std::string(reader.read_string()), "metadata");
    std::vector<packets::ReceivedPacket> views;
    while (reader.remaining() >= calibration.ouster->packet_bytes && views.size() < kMostPackets)
        views.push_back(
            {std::int64_t(views.size()) * 50000000, reader.read_bytes(calibration.ouster->packet_bytes)});
    packets::find_metadata({calibration.ouster}, "/ouster/lidar_packets",
                           views.empty() ? std::string_view() : views.front().bytes);
    packets::PacketIndex log;
    log.add_packets(views, 0, {}, calibration);
    read_turns(log, views);
}

void read_pcap(std::string_view input, const fs::path& folder) {
    put(folder / "input.pcap.gz", input);
    load_log("pcap:" + (folder / "input.pcap.gz").string(), {});
}

/// An input is the size of a packet (16 bits), and packets.
void read_blocks(std::string_view input, const fs::path&) {
    constexpr std::size_t kMostPackets = 64;
    codecs::ByteReader reader(input);
    const std::size_t bytes = std::max<std::size_t>(reader.read_number<std::uint16_t>(), 1);
    std::vector<packets::ReceivedPacket> views;
    std::string run;
    while (reader.remaining() >= bytes && views.size() < kMostPackets) {
        const std::int64_t stamp_ns = std::int64_t(views.size()) * 50000000;
        views.push_back({stamp_ns, reader.read_bytes(bytes)});
        append_raw(run, stamp_ns);
        append_raw(run, std::uint32_t(bytes));
        run += views.back().bytes;
    }
    packets::join_livox_packets(run, "livox");
    packets::PacketIndex log;
    log.add_packets(views, 0, {}, {});
    read_turns(log, views);
}

}  // namespace

std::vector<Harness> list_bag_harnesses() {
    return {{"pcap", nullptr, read_pcap, false},    {"mcap", nullptr, read_mcap},
            {"ros1", nullptr, read_ros1},           {"db3", nullptr, read_db3},
            {"message", nullptr, read_message},     {"ouster", nullptr, read_ousters},
            {"blocks", nullptr, read_blocks, false}};
}

}  // namespace relidar::fuzz
