// SPDX-License-Identifier: Apache-2.0
// Finds the product that sent a packet. The table has one row per product. If relidar
// cannot decode the packets, the row names a driver that converts them to clouds.
#include <algorithm>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "base/median.hpp"
#include "read/packets/decoder.hpp"
#include "read/packets/ouster.hpp"

namespace relidar::packets {
namespace {

using std::string_view;

constexpr std::size_t kMinAnySize = 500;  // bytes of packets that have no fixed size

// Sizes of optional fields at the end of a packet: packet number and digital signature.
constexpr std::size_t kNumber = 4, kSignature = 32;
// First bytes of the packets of Velodyne, and of RoboSense's first spinning sensors.
constexpr const char *kVelodyne = "\xff\xee", *kRoboSense = "\x55\xaa\x05\x0a\x5a\xa5\x50\xa0";

// Byte 6 of Hesai's packets is the number of lasers, byte 7 the number of blocks. Byte
// 816 of the OT128 is its mode. Byte 31 of RoboSense's packets is the model, in older
// packets byte 30.
constexpr LidarProduct kProducts[] = {
    {"VLP-16", {kVelodyne, 1206, 0, {1205, 0x22}}, make_block_decoder},
    {"VLP-32C", {kVelodyne, 1206, 0, {1205, 0x28}}, make_block_decoder},
    {"HDL-32E", {kVelodyne, 1206, 0, {1205, 0x21}}, make_block_decoder},
    {"Pandar40P", {"\xff\xee", 1262, kNumber}, make_block_decoder},
    {"Pandar64", {"\xee\xff\x40\x06", 1194, kNumber}, make_block_decoder},
    {"XT32", {"\xee\xff\x06\x01", 1076, kNumber, {6, 32}, {7, 8}}, make_block_decoder},
    {"XT16", {"\xee\xff\x06\x01", 564, kNumber, {6, 16}, {7, 8}}, make_block_decoder},
    {"XT32M", {"\xee\xff\x06\x01", 816, kNumber, {6, 32}, {7, 6}}, make_block_decoder},
    {"QT64", {"\xee\xff\x03\x01", 1068, kNumber, {6, 64}, {7, 4}}, make_block_decoder},
    {"QT128", {"\xee\xff\x03\x02", 1095, kSignature, {6, 128}, {7, 2}}, make_block_decoder},
    {"OT128 in high resolution",
     {"\xee\xff\x01\x04", 861, kSignature, {6, 128}, {816, 0}},
     make_block_decoder},
    {"OT128", {"\xee\xff\x01\x04", 861, kSignature, {6, 128}, {7, 2}}, make_block_decoder},
    {"VLS-128", {kVelodyne, 1206, 0, {1205, 0xA1}}, make_block_decoder},
    {"Puck Hi-Res", {kVelodyne, 1206, 0, {1205, 0x24}}, nullptr, "velodyne_pointcloud or nebula"},
    {"Velarray", {kVelodyne, 1206, 0, {1205, 0x63}}, nullptr, "velodyne_pointcloud"},
    {"Velodyne of an unknown model", {kVelodyne, 1206}, nullptr, "velodyne_pointcloud or nebula"},
    {"PandarQT of the first generation", {"\xee\xff\x40\x04"}, nullptr, "nebula"},
    {"Pandar128 or OT128", {"\xee\xff\x01\x04"}, nullptr, "nebula"},
    {"AT128", {"\xee\xff\x04\x03"}, nullptr, "nebula"},
    {"Hesai LiDAR of an unknown model", {"\xee\xff"}, nullptr, "hesai_ros_driver"},
    {"RS-LiDAR-16", {kRoboSense, 1248, 0, {31, 1}}, make_block_decoder},
    {"RS-LiDAR-16", {kRoboSense, 1248, 0, {31, 0}, {30, 1}}, make_block_decoder},
    {"RS-LiDAR-32", {kRoboSense, 1248, 0, {31, 2}}, nullptr, "rslidar_sdk"},
    {"RS-LiDAR-32", {kRoboSense, 1248, 0, {31, 0}, {30, 2}}, nullptr, "rslidar_sdk"},
    {"RS-BPearl", {kRoboSense, 1248, 0, {31, 3}}, nullptr, "rslidar_sdk or nebula"},
    {"RS-BPearl", {kRoboSense, 1248, 0, {31, 0}, {30, 3}}, nullptr, "rslidar_sdk or nebula"},
    {"RS-Ruby-128", {"\x55\xaa\x05\x5a", 0, 0, {80, 0xFE}, {468, 0xFE}}, nullptr, "rslidar_sdk"},
    {"RS-Ruby-80", {"\x55\xaa\x05\x5a", 0, 0, {80, 0xFE}, {324, 0xFE}}, nullptr, "rslidar_sdk"},
    {"RS-Ruby-48", {"\x55\xaa\x05\x5a", 0, 0, {80, 0xFE}, {228, 0xFE}}, nullptr, "rslidar_sdk"},
    {"RS-Helios", {"\x55\xaa\x05\x5a", 0, 0, {42, 0xFF}, {142, 0xFF}}, nullptr, "rslidar_sdk or nebula"},
    {"RS-Airy", {"\x55\xaa\x05\x5a", 0, 0, {42, 0xFF}, {190, 0xFF}}, nullptr, "rslidar_sdk"},
    {"RS-LiDAR-M1", {"\x55\xaa\x5a\xa5", 1210}, nullptr, "rslidar_sdk"},
    {"RS-LiDAR-M2", {"\x55\xaa\x5a\xa5", 1342}, nullptr, "rslidar_sdk"},
    {"RS-LiDAR-E1", {"\x55\xaa\x5a\xa5", 1200}, nullptr, "rslidar_sdk"},
    {"RoboSense model that relidar does not know", {"\x55\xaa\x05"}, nullptr, "rslidar_sdk"},
    {"RoboSense model that relidar does not know", {"\x55\xaa\x5a"}, nullptr, "rslidar_sdk"}};
// Packets without an identifying header.
constexpr LidarProduct kOusterProduct{"Ouster", {}, make_ouster_decoder},
    kLivoxProduct{"Livox", {}, nullptr, "livox_ros_driver2"};

/// Returns true if a packet has the size and the bytes that identify a product.
bool has_signature(string_view packet, const PacketSignature& signature) {
    const auto has_byte = [&](const PacketSignature::Byte& byte) {
        if (byte.value < 0) return true;  // the signature has no such byte
        return byte.at < packet.size() && static_cast<unsigned char>(packet[byte.at]) == byte.value;
    };
    const bool has_fixed_size =
        packet.size() == signature.size || packet.size() == signature.size + signature.n_optional;
    const bool has_size = signature.size == 0 ? packet.size() > kMinAnySize : has_fixed_size;
    return has_size && packet.starts_with(signature.head) && has_byte(signature.first) &&
           has_byte(signature.second);
}

bool is_rs16(string_view packet) {
    const LidarProduct* product = find_product(packet, {});
    return product && product->name == string_view("RS-LiDAR-16");
}

/// Returns the time of a packet of an RS-LiDAR-16 in microseconds within the current
/// second. Byte 26 begins two big-endian numbers: milliseconds and microseconds.
double read_clock_us(string_view packet) {
    const auto byte = [&](std::size_t at) { return double(static_cast<unsigned char>(packet[at])); };
    return 1e3 * (256.0 * byte(26) + byte(27)) + 256.0 * byte(28) + byte(29);
}

}  // namespace

const LidarProduct* find_product(string_view packet_bytes, const DecoderCalibration& calibration) {
    if (calibration.ouster && calibration.ouster->packet_bytes == packet_bytes.size()) return &kOusterProduct;
    for (const LidarProduct& product : kProducts)
        if (has_signature(packet_bytes, product.signature)) return &product;
    return is_livox_packet(packet_bytes) ? &kLivoxProduct : nullptr;
}

std::string unsupported_text(const LidarProduct* product, string_view packet_bytes) {
    std::vector<string_view> supported;
    for (const LidarProduct& row : kProducts)
        if (row.make && (supported.empty() || supported.back() != row.name)) supported.push_back(row.name);
    const std::string supported_products = fmt::format("{}", fmt::join(supported, ", "));
    constexpr std::size_t kShownBytes = 4;
    const auto* begin = reinterpret_cast<const unsigned char*>(packet_bytes.data());
    const std::vector<unsigned> first_bytes(begin, begin + std::min(packet_bytes.size(), kShownBytes));
    if (!product)
        return fmt::format("found unknown packets of {} bytes, expected {}, or an Ouster with its metadata",
                           packet_bytes.size(), supported_products);
    return fmt::format(
        "found packets of a {} ({} bytes that begin with {:02X}), expected {}; convert the packets to point "
        "clouds with {} and record these",
        product->name, packet_bytes.size(), fmt::join(first_bytes, " "), supported_products, product->driver);
}

bool is_dual_rs16(const std::vector<ReceivedPacket>& packets) {
    // time between two packets with one return per firing (24 firings)
    constexpr double kSingleReturnPeriod_us = 24 * 55.5;
    std::vector<double> steps_us;
    for (std::size_t i = 1; i < packets.size(); ++i)
        if (is_rs16(packets[i - 1].bytes) && is_rs16(packets[i].bytes)) {
            const double step_us = read_clock_us(packets[i].bytes) - read_clock_us(packets[i - 1].bytes);
            // The time does not increase if a packet is repeated or a new second begins.
            if (step_us > 0.0) steps_us.push_back(step_us);
        }
    return !steps_us.empty() && compute_median(steps_us) < 0.75 * kSingleReturnPeriod_us;
}

}  // namespace relidar::packets
