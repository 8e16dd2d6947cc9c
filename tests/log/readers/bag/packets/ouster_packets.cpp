// SPDX-License-Identifier: Apache-2.0
#include "log/readers/bag/packets/ouster_packets.hpp"

#include <fstream>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "base/bytes.hpp"

namespace relidar::test {
namespace {

void add_pixel(std::string& bytes, const OusterImages& images, std::size_t index) {
    const std::uint32_t mm = images.range_mm[index], bright = images.reflectivity[index];
    if (images.profile == kLegacy) {
        append_binary_value(bytes, mm | 0xA00000u);  // bits above the range are flags
        append_binary_value(bytes, std::uint16_t(bright));
        append_binary_value(bytes, std::uint16_t(500));
        append_binary_value(bytes, std::uint32_t(77));
    } else if (images.profile == kSingle) {
        append_binary_value(bytes, mm | 0x80000u);
        append_binary_value(bytes, std::uint8_t(bright));
        append_binary_value(bytes, std::uint8_t(0xEE));
        append_binary_value(bytes, std::uint16_t(500));
        append_binary_value(bytes, std::uint32_t(77));
    } else if (images.profile == kDual) {
        const bool has_second = !images.range_2_mm.empty();
        append_binary_value(bytes, mm | bright << 24);
        append_binary_value(bytes,
                            has_second ? images.range_2_mm[index] | images.reflectivity_2[index] << 24 : 0u);
        append_binary_value(bytes, std::uint32_t(0x01F401F4));
        append_binary_value(bytes, std::uint32_t(77));
    } else {
        append_binary_value(bytes, std::uint32_t(mm / 8 | 0x8000u | bright << 16 | 0x77000000u));
        if (images.is_dual())
            append_binary_value(
                bytes, images.range_2_mm.empty()
                           ? 0u
                           : images.range_2_mm[index] / 8 | images.reflectivity_2[index] << 16 | 0x55000000u);
    }
}

std::string make_column_bytes(const OusterImages& images, std::size_t frame, std::size_t column) {
    std::string bytes;
    const bool is_valid = (images.is_valid.empty() || images.is_valid[frame * images.columns + column]) &&
                          images.is_in_window(column);
    append_binary_value(bytes, images.time_ns[frame * images.columns + column]);
    append_binary_value(bytes, std::uint16_t(column));
    if (images.profile == kLegacy) {
        append_binary_value(bytes, std::uint16_t(frame));
        append_binary_value(bytes, std::uint32_t(column * 90112 / images.columns));
    } else append_binary_value(bytes, std::uint16_t(is_valid ? 0x0101 : 0x0100));
    for (std::size_t row = 0; row < images.rows; ++row)
        add_pixel(bytes, images, images.at(frame, row, column));
    if (images.profile == kLegacy) append_binary_value(bytes, std::uint32_t(is_valid ? 0xFFFFFFFF : 0));
    return bytes;
}

std::string read_big_endian(std::uint16_t value) { return {char(value >> 8), char(value & 0xff)}; }

}  // namespace

std::vector<OusterPacket> make_packets(const OusterImages& images) {
    std::vector<OusterPacket> packets;
    for (std::size_t frame = 0; frame < images.frames; ++frame)
        for (std::size_t begin = 0; begin < images.columns; begin += images.per_packet) {
            const std::size_t end = begin + images.per_packet;
            bool any = false;
            std::string bytes;
            if (images.profile != kLegacy) {
                // a FUSA header starts with the type in a single byte, followed by the
                // number of the last reboot
                append_binary_value(bytes, std::uint16_t(images.profile == kFusa ? 0xBC01 : 1));
                append_binary_value(bytes, std::uint16_t(frame));
                bytes.append(28, '\x21');
            }
            for (std::size_t column = begin; column < end; ++column) {
                bytes += make_column_bytes(images, frame, column);
                any = any || images.is_in_window(column);
            }
            if (images.profile != kLegacy) bytes.append(32, '\x42');
            if (any) packets.push_back({images.time_ns[frame * images.columns + end - 1], bytes});
        }
    return packets;
}

std::string make_metadata(const OusterImages& images, int port, bool is_nested) {
    const std::size_t last = images.last == 0 ? images.columns - 1 : images.last;
    const std::string beams = fmt::format(
        R"("beam_altitude_angles": [{}], "beam_azimuth_angles": [{}], "lidar_origin_to_beam_origin_mm": {})",
        fmt::join(images.altitude_deg, ", "), fmt::join(images.azimuth_deg, ", "), images.n_mm);
    const std::string layout = fmt::format(
        R"({{"columns_per_frame": {}, "columns_per_packet": {}, "pixels_per_column": {}, "column_window": [{}, {}], )"
        R"("udp_profile_lidar": "{}"}})",
        images.columns, images.per_packet, images.rows, images.first, last, images.profile);
    if (is_nested)
        return fmt::format(
            R"({{"beam_intrinsics": {{{}}}, "lidar_data_format": {}, "config_params": {{"lidar_mode": "{}x10", )"
            R"("udp_port_lidar": {}}}, "sensor_info": {{"prod_line": "{}", "prod_sn": "122150000123"}}}})",
            beams, layout, images.columns, port, images.product);
    return fmt::format(
        R"({{{}, "data_format": {}, "lidar_mode": "{}x10", "udp_port_lidar": {}, "prod_line": "{}"}})", beams,
        layout, images.columns, port, images.product);
}

std::vector<Datagram> receive(const std::vector<OusterPacket>& packets, int port, std::int64_t ahead_ns) {
    constexpr std::int64_t kLate_ns = 200000;
    std::vector<Datagram> datagrams;
    for (std::size_t k = 0; k < packets.size(); ++k)
        datagrams.push_back({ahead_ns + std::int64_t(packets[k].time_ns) + kLate_ns +
                                 (k % 3 == 1 ? std::int64_t(k * 7919 % 400000) : 0),
                             packets[k].bytes, port});
    return datagrams;
}

void write_pcap(const std::filesystem::path& file, const std::vector<Datagram>& datagrams) {
    std::string bytes;
    append_binary_value(bytes, std::uint32_t(0xA1B23C4D));
    append_binary_value(bytes, std::uint32_t(0x00040002));
    for (const std::uint32_t word : {0u, 0u, 262144u, 1u}) append_binary_value(bytes, word);
    for (const Datagram& datagram : datagrams) {
        const std::size_t udp = 8 + datagram.bytes.size(), frame = 14 + 20 + udp;
        append_binary_value(bytes, std::uint32_t(datagram.stamp_ns / 1000000000));
        append_binary_value(bytes, std::uint32_t(datagram.stamp_ns % 1000000000));
        append_binary_value(bytes, std::uint32_t(frame));
        append_binary_value(bytes, std::uint32_t(frame));
        bytes.append(12, '\0').append("\x08\x00", 2);
        bytes.append("\x45\x00", 2)
            .append(read_big_endian(std::uint16_t(20 + udp)))
            .append(4, '\0')
            .append("\x40\x11\x00\x00", 4);
        bytes.append("\xC0\xA8\x01\xC9\xFF\xFF\xFF\xFF", 8);  // from 192.168.1.201
        bytes.append(read_big_endian(7502))
            .append(read_big_endian(std::uint16_t(datagram.port)))
            .append(read_big_endian(std::uint16_t(udp)));
        bytes.append(2, '\0').append(datagram.bytes);
    }
    std::ofstream(file, std::ios::binary) << bytes;
}

void add_second_returns(OusterImages& images) {
    images.range_2_mm.assign(images.range_mm.size(), 0);
    images.reflectivity_2 = images.range_2_mm;
    for (std::size_t i = 0; i < images.range_mm.size(); i += 5)
        if (images.range_mm[i] > 0) {
            images.range_2_mm[i] = images.range_mm[i] + 1500;
            images.reflectivity_2[i] = std::uint32_t(3 + i % 200);
        }
}

OusterImages make_small_images(const std::string& profile) {
    OusterImages images;
    images.profile = profile;
    images.frames = 4;
    images.rows = 16;
    images.columns = 128;
    images.n_mm = 15.8;
    for (std::size_t row = 0; row < images.rows; ++row) {  // not ordered by altitude
        images.altitude_deg.push_back(15.0 - 2.0 * double(row ^ 1));
        images.azimuth_deg.push_back(row % 2 == 0 ? 2.8125 : -2.8125);
    }
    for (std::size_t frame = 0; frame < images.frames; ++frame)
        for (std::size_t row = 0; row < images.rows; ++row)
            for (std::size_t column = 0; column < images.columns; ++column) {
                const std::size_t k = frame + 3 * row + 7 * column;
                images.range_mm.push_back(k % 6 == 0 ? 0
                                                     : std::uint32_t(4000 + 40 * row + 16 * column + frame));
                images.reflectivity.push_back(std::uint32_t(k % 256));
            }
    for (std::size_t k = 0; k < images.frames * images.columns; ++k)
        images.time_ns.push_back(5000000000 + 781250 * k + k % 2 * 900);
    if (images.is_dual()) add_second_returns(images);
    return images;
}

}  // namespace relidar::test
