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

constexpr std::size_t kVelodyneBytes = 1206, kProductAt = 1205, kLasersAt = 6, kBlocksAt = 7;

bool has_byte_at(string_view packet, std::size_t offset, int expected_value) {
    return offset < packet.size() && static_cast<unsigned char>(packet[offset]) == expected_value;
}
bool is_velodyne(string_view packet) {
    return packet.size() == kVelodyneBytes && packet.starts_with("\xff\xee");
}
template <int product>
bool is_velodyne_model(string_view packet) {
    return is_velodyne(packet) && has_byte_at(packet, kProductAt, product);
}
/// Header of newer Hesai sensors: the bytes EE FF and the protocol version.
template <int major, int minor>
bool is_hesai(string_view packet) {
    return packet.size() > 500 && packet.starts_with("\xee\xff") && has_byte_at(packet, 2, major) &&
           has_byte_at(packet, 3, minor);
}
/// @tparam bytes  packet size without the optional fields at the end
template <int major, int minor, int lasers, int blocks, std::size_t bytes, std::size_t optional>
bool is_hesai_model(string_view packet) {
    return is_hesai<major, minor>(packet) && has_byte_at(packet, kLasersAt, lasers) &&
           has_byte_at(packet, kBlocksAt, blocks) &&
           (packet.size() == bytes || packet.size() == bytes + optional);
}
/// RoboSense's first spinning sensors. Byte 31, in older packets byte 30, is the model.
template <int model>
bool is_robosense(string_view packet) {
    return packet.size() == 1248 && packet.starts_with("\x55\xaa\x05\x0a\x5a\xa5\x50\xa0") &&
           has_byte_at(packet, has_byte_at(packet, 31, 0) ? 30 : 31, model);
}
constexpr auto is_rs16 = is_robosense<1>;
/// RoboSense Ruby, Helios or Airy: the first two blocks begin with the byte `flag`.
template <int flag, std::size_t first_block_at, std::size_t second_block_at>
bool is_flagged(string_view packet) {
    return packet.starts_with("\x55\xaa\x05\x5a") && has_byte_at(packet, first_block_at, flag) &&
           has_byte_at(packet, second_block_at, flag);
}
/// RoboSense's sensors that do not spin.
template <std::size_t bytes>
bool is_solid_state(string_view packet) {
    return packet.size() == bytes && packet.starts_with("\x55\xaa\x5a\xa5");
}
// Sizes of optional fields at the end of a packet: packet number and digital signature.
constexpr std::size_t kNumberBytes = 4, kSignatureBytes = 32;
constexpr std::size_t kOt128ModeAt = 816;  // 0: high resolution
constexpr auto is_ot128 = is_hesai_model<1, 4, 128, 2, 861, kSignatureBytes>;

constexpr LidarProduct kProducts[] = {
    {"VLP-16", is_velodyne_model<0x22>, make_block_decoder},
    {"VLP-32C", is_velodyne_model<0x28>, make_block_decoder},
    {"HDL-32E", is_velodyne_model<0x21>, make_block_decoder},
    {"Pandar40P",
     [](string_view p) { return (p.size() == 1262 || p.size() == 1266) && p.starts_with("\xff\xee"); },
     make_block_decoder},
    {"Pandar64",
     [](string_view p) {
         return (p.size() == 1194 || p.size() == 1198) && p.starts_with("\xee\xff\x40\x06");
     },
     make_block_decoder},
    {"XT32", is_hesai_model<6, 1, 32, 8, 1076, kNumberBytes>, make_block_decoder},
    {"XT16", is_hesai_model<6, 1, 16, 8, 564, kNumberBytes>, make_block_decoder},
    {"XT32M", is_hesai_model<6, 1, 32, 6, 816, kNumberBytes>, make_block_decoder},
    {"QT64", is_hesai_model<3, 1, 64, 4, 1068, kNumberBytes>, make_block_decoder},
    {"QT128", is_hesai_model<3, 2, 128, 2, 1095, kSignatureBytes>, make_block_decoder},
    {"OT128", [](string_view p) { return is_ot128(p) && !has_byte_at(p, kOt128ModeAt, 0); },
     make_block_decoder},
    {"OT128 in high resolution", is_ot128, make_block_decoder},
    {"VLS-128", is_velodyne_model<0xA1>, make_block_decoder},
    {"Puck Hi-Res", is_velodyne_model<0x24>, nullptr, "velodyne_pointcloud or nebula"},
    {"Velarray", is_velodyne_model<0x63>, nullptr, "velodyne_pointcloud"},
    {"Velodyne of an unknown model", is_velodyne, nullptr, "velodyne_pointcloud or nebula"},
    {"PandarQT of the first generation",
     [](string_view p) { return p.size() >= 1072 && p.starts_with("\xee\xff\x40\x04"); }, nullptr, "nebula"},
    {"Pandar128 or OT128", is_hesai<1, 4>, nullptr, "nebula"},
    {"AT128", is_hesai<4, 3>, nullptr, "nebula"},
    {"Hesai LiDAR of an unknown model",
     [](string_view p) { return p.size() > 500 && p.starts_with("\xee\xff"); }, nullptr, "hesai_ros_driver"},
    {"RS-LiDAR-16", is_rs16, make_block_decoder},
    {"RS-LiDAR-32", is_robosense<2>, nullptr, "rslidar_sdk"},
    {"RS-BPearl", is_robosense<3>, nullptr, "rslidar_sdk or nebula"},
    {"RS-Ruby-128", is_flagged<0xFE, 80, 468>, nullptr, "rslidar_sdk"},
    {"RS-Ruby-80", is_flagged<0xFE, 80, 324>, nullptr, "rslidar_sdk"},
    {"RS-Ruby-48", is_flagged<0xFE, 80, 228>, nullptr, "rslidar_sdk"},
    {"RS-Helios", is_flagged<0xFF, 42, 142>, nullptr, "rslidar_sdk or nebula"},
    {"RS-Airy", is_flagged<0xFF, 42, 190>, nullptr, "rslidar_sdk"},
    {"RS-LiDAR-M1", is_solid_state<1210>, nullptr, "rslidar_sdk"},
    {"RS-LiDAR-M2", is_solid_state<1342>, nullptr, "rslidar_sdk"},
    {"RS-LiDAR-E1", is_solid_state<1200>, nullptr, "rslidar_sdk"},
    {"RoboSense model that relidar does not know",
     [](string_view p) {
         return p.size() > 500 && (p.starts_with("\x55\xaa\x05") || p.starts_with("\x55\xaa\x5a"));
     },
     nullptr, "rslidar_sdk"},
    {"Livox", is_livox_packet, nullptr, "livox_ros_driver2"},
};

/// Returns the time in microseconds within the current second.
double read_clock_us(string_view packet) {
    const auto byte = [&](std::size_t at) { return double(static_cast<unsigned char>(packet[at])); };
    return 1e3 * (256.0 * byte(26) + byte(27)) + 256.0 * byte(28) + byte(29);
}

/// Packets without an identifying header.
constexpr LidarProduct kOusterProduct{"Ouster", nullptr, make_ouster_decoder};

}  // namespace

const LidarProduct* find_product(string_view packet_bytes, const DecoderCalibration& calibration) {
    if (calibration.ouster && calibration.ouster->packet_bytes == packet_bytes.size()) return &kOusterProduct;
    const auto* product =
        std::ranges::find_if(kProducts, [&](const LidarProduct& row) { return row.is(packet_bytes); });
    return product == std::end(kProducts) ? nullptr : product;
}

std::string unsupported_text(const LidarProduct* product, string_view packet_bytes) {
    std::string supported_products;
    for (const LidarProduct& row : kProducts)
        if (row.make) supported_products += (supported_products.empty() ? "" : ", ") + std::string(row.name);
    const auto* begin = reinterpret_cast<const unsigned char*>(packet_bytes.data());
    const std::vector<unsigned> first(begin, begin + std::min(packet_bytes.size(), std::size_t(4)));
    if (!product)
        return fmt::format("found unknown packets of {} bytes, expected {}, or an Ouster with its metadata",
                           packet_bytes.size(), supported_products);
    return fmt::format(
        "found packets of a {} ({} bytes that begin with {:02X}), expected {}; convert the packets to point "
        "clouds with {} and record these",
        product->name, packet_bytes.size(), fmt::join(first, " "), supported_products, product->driver);
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
