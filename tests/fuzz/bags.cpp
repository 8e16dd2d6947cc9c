// SPDX-License-Identifier: Apache-2.0
// ROS recordings: full files of each format, and single messages, by the specifications.
#include "harness.hpp"

#include <cmath>

#include <lz4frame.h>
#include <sqlite3.h>
#include <zstd.h>

#include <relidar/read/dataset.hpp>

#include "base/bytes.hpp"
#include "base/codecs/byte_reader.hpp"
#include "read/packets/ouster.hpp"
#include "read/packets/packet_log.hpp"
#include "read/packets/packet_messages.hpp"

namespace relidar::fuzz {
namespace {

namespace fs = std::filesystem;

constexpr std::uint64_t kSecond_ns = 1000000000, kStart_ns = 1700000000 * kSecond_ns;

template <class... T>
std::string pack(T... numbers) {
    std::string bytes;
    (append_raw(bytes, numbers), ...);
    return bytes;
}

std::string sized(std::string_view bytes) { return pack(std::uint32_t(bytes.size())).append(bytes); }

/// Builds a message in the serialization of ROS 1 or in CDR (ROS 2).
class Draft {
public:
    explicit Draft(bool is_ros1) : is_ros1_(is_ros1) {}
    template <class... T>
    Draft& add(T... values) {
        const auto add_one = [&](auto value) {
            while (!is_ros1_ && bytes_.size() % sizeof(value) != 0) bytes_ += '\0';
            append_raw(bytes_, value);
        };
        (add_one(values), ...);
        return *this;
    }
    Draft& add_text(std::string_view text) {
        add(std::uint32_t(text.size() + !is_ros1_));
        bytes_ += text;
        if (!is_ros1_) bytes_ += '\0';
        return *this;
    }
    Draft& add_header(std::uint64_t stamp_ns, std::string_view frame) {
        if (is_ros1_) add(std::uint32_t(0));
        return add(std::uint32_t(stamp_ns / kSecond_ns), std::uint32_t(stamp_ns % kSecond_ns))
            .add_text(frame);
    }
    std::string take() const { return is_ros1_ ? bytes_ : std::string("\0\1\0\0", 4) + bytes_; }

private:
    bool is_ros1_;
    std::string bytes_;
};

std::string cloud(bool is_ros1, std::uint64_t stamp_ns) {
    struct Field {
        const char* name;
        std::uint32_t offset;
        std::uint8_t type;
    };
    constexpr Field kFields[] = {{"x", 0, 7},          {"y", 4, 7},     {"z", 8, 7},
                                 {"intensity", 12, 2}, {"ring", 14, 4}, {"time", 16, 7}};
    std::string points;
    for (int column = 0; column < 24; ++column)
        for (int ring = 0; ring < 4; ++ring) {
            const float azimuth = 3.14f - 0.2618f * float(column);
            for (const float v : {9.0f * std::cos(azimuth), 9.0f * std::sin(azimuth), 0.5f * float(ring)})
                append_raw(points, v);
            points += pack(std::uint16_t(7), std::uint16_t(ring), 0.004f * float(column));
        }
    Draft draft(is_ros1);
    draft.add_header(stamp_ns, "lidar").add(1u, 96u, std::uint32_t(std::size(kFields)));
    for (const Field& field : kFields) draft.add_text(field.name).add(field.offset, field.type, 1u);
    draft.add(std::uint8_t(0), 20u, std::uint32_t(points.size()), std::uint32_t(points.size()));
    for (const char byte : points) draft.add(byte);
    return draft.add(std::uint8_t(1)).take();
}

std::string transform(bool is_ros1, std::uint64_t stamp_ns, double value) {
    Draft draft(is_ros1);
    draft.add(1u).add_header(stamp_ns, "map").add_text("lidar");
    return draft.add(value, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0).take();
}

/// Returns a packet of a VLP-16. Each packet covers half a turn.
std::string make_packet(int number) {
    std::string bytes;
    for (int b = 0; b < 12; ++b) {
        bytes += pack(std::uint16_t(0xEEFF), std::uint16_t((b * 1500 + number * 18000) % 36000));
        for (int l = 0; l < 32; ++l) bytes += pack(std::uint16_t(2000)) + '\x09';
    }
    return bytes + pack(std::uint32_t(number * 50000), std::uint16_t(0x2239));
}

std::string make_packets(std::uint64_t stamp_ns) {
    Draft draft(false);
    draft.add_header(stamp_ns, "velodyne").add(std::uint32_t(2));
    for (int k = 0; k < 2; ++k) {
        const std::string bytes = make_packet(k);
        draft.add(std::uint32_t(stamp_ns / kSecond_ns), std::uint32_t(stamp_ns % kSecond_ns));
        for (const char byte : bytes) draft.add(byte);
    }
    return draft.take();
}

struct SeedMessage {
    int topic;  ///< 0 /points, 1 /tf, 2 /packets
    std::uint64_t time_ns;
    std::string bytes;
};
constexpr const char* kTopics[] = {"/points", "/tf", "/packets"};
constexpr const char* kTypes[] = {"sensor_msgs/PointCloud2", "tf2_msgs/TFMessage",
                                  "velodyne_msgs/VelodyneScan"};

std::vector<SeedMessage> make_seed_messages(bool is_ros1) {
    std::vector<SeedMessage> messages;
    for (int k = 0; k < 3; ++k) {
        const std::uint64_t time_ns = kStart_ns + std::uint64_t(k) * 100000000;
        messages.push_back({0, time_ns, cloud(is_ros1, time_ns)});
        messages.push_back({1, time_ns, transform(is_ros1, time_ns, k)});
    }
    return messages;
}

std::string make_mcap_record(std::uint8_t code, std::string_view body) {
    return pack(code, std::uint64_t(body.size())).append(body);
}

std::string make_mcap(const std::string& compression) {
    std::string records;
    for (int t = 0; t < 2; ++t) {
        const std::string id = pack(std::uint16_t(t + 1));
        records += make_mcap_record(3, id + sized(kTypes[t]) + sized("ros2msg") + sized(""));
        records += make_mcap_record(4, id + id + sized(kTopics[t]) + sized("cdr") + sized(""));
    }
    for (const SeedMessage& message : make_seed_messages(false)) {
        const std::string head = pack(std::uint16_t(message.topic + 1), 0u, message.time_ns, message.time_ns);
        records += make_mcap_record(5, head + message.bytes);
    }
    const std::string magic("\x89MCAP0\r\n", 8);
    if (compression == "no chunk") return magic + records + make_mcap_record(15, std::string(4, '\0'));
    std::string packed = records;
    if (compression == "lz4") {
        packed.resize(LZ4F_compressFrameBound(records.size(), nullptr));
        packed.resize(
            LZ4F_compressFrame(packed.data(), packed.size(), records.data(), records.size(), nullptr));
    } else if (compression == "zstd") {
        packed.resize(ZSTD_compressBound(records.size()));
        packed.resize(ZSTD_compress(packed.data(), packed.size(), records.data(), records.size(), 3));
    }
    const std::string chunk = std::string(16, '\0') + pack(std::uint64_t(records.size()), 0u) +
                              sized(compression) + pack(std::uint64_t(packed.size()));
    return magic + make_mcap_record(6, chunk + packed);
}

std::vector<std::string> make_mcap_seeds(const fs::path&) {
    return {make_mcap("no chunk"), make_mcap(""), make_mcap("lz4"), make_mcap("zstd")};
}

std::string make_ros1_record(const std::vector<std::pair<std::string, std::string>>& fields,
                             std::string_view data) {
    std::string header;
    for (const auto& [name, value] : fields) header += sized(name + "=" + value);
    return sized(header) + sized(data);
}

std::vector<std::string> make_ros1_seeds(const fs::path&) {
    std::string records;
    for (std::uint32_t t = 0; t < 2; ++t) {
        const std::string about =
            sized(std::string("topic=") + kTopics[t]) + sized(std::string("type=") + kTypes[t]);
        records += make_ros1_record({{"op", "\x07"}, {"conn", pack(t)}, {"topic", kTopics[t]}}, about);
    }
    for (const SeedMessage& m : make_seed_messages(true)) {
        const std::string time =
            pack(std::uint32_t(m.time_ns / kSecond_ns), std::uint32_t(m.time_ns % kSecond_ns));
        records += make_ros1_record({{"op", "\x02"}, {"conn", pack(std::uint32_t(m.topic))}, {"time", time}},
                                    m.bytes);
    }
    const std::string magic = "#ROSBAG V2.0\n";
    return {magic + records, magic + make_ros1_record({{"op", "\x05"},
                                                       {"compression", "none"},
                                                       {"size", pack(std::uint32_t(records.size()))}},
                                                      records)};
}

std::vector<std::string> make_db3_seeds(const fs::path& folder) {
    const fs::path file = folder / "seed.db3";
    fs::remove(file);
    sqlite3* base = nullptr;
    sqlite3_open(file.c_str(), &base);
    sqlite3_exec(base,
                 "CREATE TABLE topics(id INTEGER PRIMARY KEY,name TEXT,type TEXT,serialization_format "
                 "TEXT,offered_qos_profiles TEXT);CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id "
                 "INTEGER,timestamp INTEGER,data BLOB);INSERT INTO topics VALUES "
                 "(0,'/points','sensor_msgs/msg/PointCloud2','cdr','');INSERT INTO topics VALUES "
                 "(1,'/tf','tf2_msgs/msg/TFMessage','cdr','')",
                 nullptr, nullptr, nullptr);
    for (const SeedMessage& m : make_seed_messages(false)) {
        sqlite3_stmt* row = nullptr;
        sqlite3_prepare_v2(base, "INSERT INTO messages(topic_id,timestamp,data) VALUES (?,?,?)", -1, &row,
                           nullptr);
        sqlite3_bind_int(row, 1, m.topic);
        sqlite3_bind_int64(row, 2, std::int64_t(m.time_ns));
        sqlite3_bind_blob(row, 3, m.bytes.data(), int(m.bytes.size()), SQLITE_TRANSIENT);
        sqlite3_step(row);
        sqlite3_finalize(row);
    }
    sqlite3_close(base);
    const std::string bytes = read_contents(file);
    fs::remove(file);
    return {bytes};
}

template <class Name>
void read_bag(std::string_view input, const fs::path& folder, Name name) {
    put(folder / name, input);
    load_sequence("rosbag:" + (folder / name).string(), {});
}
void read_mcap(std::string_view input, const fs::path& folder) { read_bag(input, folder, "input.mcap"); }
void read_ros1(std::string_view input, const fs::path& folder) { read_bag(input, folder, "input.bag"); }
void read_db3(std::string_view input, const fs::path& folder) { read_bag(input, folder, "input.db3"); }

/// The first byte of a seed is the message type and a flag for ROS 1.
std::vector<std::string> make_message_seeds(const fs::path&) {
    std::string livox = Draft(false)
                            .add_header(kStart_ns, "l")
                            .add(std::uint64_t(0), 1u, 0u, 1u, 5u, 1.0f, 2.0f, 3.0f, '\1', '\1', '\1')
                            .take();
    Draft detections(false), objects(false);
    detections.add_header(kStart_ns, "map").add(1u).add_header(kStart_ns, "map").add(0u);
    detections.add(1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0, 4.0, 2.0, 1.5).add_text("7");
    objects.add_header(kStart_ns, "map").add(1u);
    for (int i = 0; i < 16; ++i) objects.add(std::uint8_t(i));
    objects.add(1.0f, 1u, '\1', 1.0f);
    for (int i = 0; i < 7 + 36 + 2 * 42; ++i) objects.add(i == 6 ? 1.0 : 0.0);
    objects.add('\2', '\0', '\0', 0u, 4.0, 2.0, 1.5);
    return {std::string(1, '\0') + cloud(false, kStart_ns),
            '\1' + cloud(true, kStart_ns),
            '\2' + transform(false, kStart_ns, 1.0),
            '\3' + transform(true, kStart_ns, 1.0),
            '\4' + make_packets(kStart_ns),
            '\6' + livox,
            '\x12' + detections.take(),
            '\x14' + objects.take(),
            '\x1b' + sized(make_packet(0)),
            '\x1c' + Draft(false).add_text("{}").take()};
}

void read_turns(packets::PacketIndex& log, const std::vector<packets::ReceivedPacket>& views) {
    if (log.empty()) return;
    log.finish();
    log.describe_faults();
    const SpinningSensor sensor = log.make_sensor();
    for (const packets::PacketRevolution& revolution : log.revolutions())
        log.decode(revolution, std::vector(log.messages_of(revolution).size(), views), sensor,
                   revolution.forward_ns);
}

void read_message(std::string_view input, const fs::path&) {
    static constexpr const char* kMessages[] = {"sensor_msgs/PointCloud2",
                                                "tf2_msgs/TFMessage",
                                                "velodyne_msgs/VelodyneScan",
                                                "livox_ros_driver2/CustomMsg",
                                                "nav_msgs/Odometry",
                                                "geometry_msgs/PoseStamped",
                                                "foxglove.PointCloud",
                                                "foxglove.FrameTransforms",
                                                "foxglove.SceneUpdate",
                                                "vision_msgs/Detection3DArray",
                                                "autoware_perception_msgs/TrackedObjects",
                                                "nebula_msgs/NebulaPackets",
                                                "pandar_msgs/PandarScan",
                                                "ouster_ros/PacketMsg",
                                                "std_msgs/String"};
    if (input.empty()) return;
    const unsigned kind = static_cast<unsigned char>(input[0]);
    const std::size_t type = kind / 2 % std::size(kMessages);
    const std::string topic_type = kMessages[type];
    const char* encoding = kind % 2 ? "ros1" : "cdr";
    if (topic_type.starts_with("foxglove.")) encoding = "protobuf";
    const bag::BagTopic topic{"/t", topic_type, encoding};
    const std::string_view bytes = input.substr(1);
    if (bag::find_purpose(topic) == bag::MessagePurpose::cloud) {
        const SharedBytes message = share_bytes(std::string(bytes));
        bag::to_point_table(bag::read_cloud(topic, message.bytes), message);
    } else if (bag::find_purpose(topic) == bag::MessagePurpose::packets) {
        bag::MessageHeader header;
        packets::PacketIndex log;
        const std::vector<packets::ReceivedPacket> views = packets::read_packets(topic, bytes, 0, header);
        for (int k = 0; k < 2; ++k) log.add_packets(views, 0, {}, {});
        read_turns(log, views);
    } else if (bag::find_purpose(topic) == bag::MessagePurpose::boxes) {
        bag::read_boxes(topic, bytes);
    } else if (topic_type == "std_msgs/String") {
        packets::read_std_string(topic, bytes);
    } else {
        bag::read_transforms(topic, bytes);
    }
}

/// Seeds: the length of the metadata, the metadata, and packets of two beams, four
/// columns per turn and two columns per packet.
std::vector<std::string> make_ouster_seeds(const fs::path&) {
    struct Profile {
        const char* name;
        std::size_t pixel_bytes;
        bool is_nested;
    };
    std::vector<std::string> seeds;
    for (const Profile& profile :
         {Profile{"LEGACY", 12, false}, Profile{"RNG19_RFL8_SIG16_NIR16", 12, true},
          Profile{"RNG19_RFL8_SIG16_NIR16_DUAL", 16, false}, Profile{"RNG15_RFL8_NIR8", 4, true}}) {
        const bool is_legacy = std::string_view(profile.name) == "LEGACY";
        const std::string layout =
            std::string(R"({"columns_per_frame": 4, "columns_per_packet": 2, "pixels_per_column": 2, )") +
            R"("column_window": [0, 3], "udp_profile_lidar": ")" + profile.name + "\"}";
        const std::string beams =
            std::string(R"("beam_altitude_angles": [-1, 1], "beam_azimuth_angles": [3, -3], )") +
            R"("lidar_origin_to_beam_origin_mm": 15)";
        std::string seed = sized(
            profile.is_nested ? "{\"beam_intrinsics\": {" + beams + "}, \"lidar_data_format\": " + layout +
                                    R"(, "config_params": {"lidar_mode": "4x10", "udp_port_lidar": 7502}})"
                              : "{" + beams + ", \"data_format\": " + layout + R"(, "lidar_mode": "4x10"})");
        for (int column = 0; column < 24; ++column) {
            if (!is_legacy && column % 2 == 0) {
                seed += pack(1u) + std::string(28, '\0');
            }
            seed += pack(std::uint64_t(column) * 25000000, std::uint16_t(column % 4));
            seed.append(is_legacy ? 6 : 2, '\1');
            for (int pixel = 0; pixel < 2; ++pixel) {
                seed += pack(0x05000400u) + std::string(profile.pixel_bytes - 4, '\2');
            }
            if (is_legacy) seed += pack(0xFFFFFFFFu);
            if (!is_legacy && column % 2 == 1) seed.append(32, '\0');
        }
        seeds.push_back(seed);
    }
    return seeds;
}

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

struct BlockPacket {
    std::string_view head;
    std::size_t bytes;
};

/// The size of a packet (16 bits), then eight packets.
std::vector<std::string> make_block_seeds(const fs::path&) {
    using namespace std::string_view_literals;
    constexpr BlockPacket kPackets[] = {
        {"\xee\xff\x06\x01\0\0\x10\x08\0\x04\x01\x01"sv, 568},   // XT16
        {"\xee\xff\x06\x01\0\0\x20\x06\0\x05\x01\x01"sv, 820},   // XT32M
        {"\xee\xff\x03\x01\0\0\x40\x04\0\x04\x01\x01"sv, 1072},  // QT64
        {"\xee\xff\x03\x02\0\0\x80\x02\0\x04\x01\x05"sv, 1095},  // QT128
        {"\xee\xff\x01\x04\0\0\x80\x02\0\x04\x01\x07"sv, 861},   // OT128
        {"\x55\xaa\x05\x0a\x5a\xa5\x50\xa0\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1"sv,
         1248},                                       // RS-LiDAR-16
        {"\0\x64\0\x10\x27\x20\0\0\0\0\x01"sv, 484},  // Livox, 32 points
    };
    std::vector<std::string> seeds;
    for (const BlockPacket& packet : kPackets) {
        std::string seed = pack(std::uint16_t(packet.bytes));
        for (int k = 0; k < 8; ++k)
            seed.append(packet.head).append(packet.bytes - packet.head.size(), char(k));
        seeds.push_back(seed);
    }
    return seeds;
}

std::vector<std::string> pcap_seeds(const fs::path&) {
    constexpr std::size_t kPacket = 1206, kHeads = 14 + 20 + 8;  // Ethernet, IPv4 and UDP
    std::string capture("\xd4\xc3\xb2\xa1\2\0\4\0\0\0\0\0\0\0\0\0\xff\xff\0\0\1\0\0\0", 24);
    for (int k = 0; k < 8; ++k) {
        const auto time_us = std::uint32_t(50000 * k), size = std::uint32_t(kHeads + kPacket);
        capture += pack(0u, time_us, size, size);
        capture.append(12, '\1').append("\x08\0\x45\0\x04\xd2\0\0\0\0\x40\x11\0\0", 14);
        capture.append("\xc0\xa8\1\xc9\xff\xff\xff\xff\x09\x40\x09\x40\x04\xbe\0\0", 16);
        for (int block = 0; block < 12; ++block) {
            capture += "\xff\xee" + pack(std::uint16_t(4500 * k + 370 * block)) + std::string(96, '\x10');
        }
        capture += pack(time_us) + "\x37\x22";
    }
    return {capture};
}

void read_pcap(std::string_view input, const fs::path& folder) {
    put(folder / "input.pcap.gz", input);
    load_sequence("pcap:" + (folder / "input.pcap.gz").string(), {});
}

void read_blocks(std::string_view input, const fs::path&) {
    constexpr std::size_t kMostPackets = 64;
    codecs::ByteReader reader(input);
    const std::size_t bytes = std::max<std::size_t>(reader.read_number<std::uint16_t>(), 1);
    std::vector<packets::ReceivedPacket> views;
    std::string run;
    while (reader.remaining() >= bytes && views.size() < kMostPackets) {
        const std::int64_t stamp_ns = std::int64_t(views.size()) * 50000000;
        views.push_back({stamp_ns, reader.read_bytes(bytes)});
        run += pack(stamp_ns) + sized(views.back().bytes);
    }
    packets::join_livox_packets(run, "livox");
    packets::PacketIndex log;
    log.add_packets(views, 0, {}, {});
    read_turns(log, views);
}

}  // namespace

std::vector<Harness> list_bag_harnesses() {
    return {{"pcap", pcap_seeds, read_pcap, false},
            {"mcap", make_mcap_seeds, read_mcap},
            {"ros1", make_ros1_seeds, read_ros1},
            {"db3", make_db3_seeds, read_db3},
            {"message", make_message_seeds, read_message},
            {"ouster", make_ouster_seeds, read_ousters},
            {"blocks", make_block_seeds, read_blocks, false}};
}

}  // namespace relidar::fuzz
