// SPDX-License-Identifier: Apache-2.0
#include "read/packets/ouster_packets.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <fstream>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/arrays.hpp>

#include "base/bytes.hpp"

namespace relidar::test {
namespace {

void add_pixel(std::string& bytes, const OusterImages& images, std::size_t index) {
    const std::uint32_t mm = images.range_mm[index], bright = images.reflectivity[index];
    const std::uint32_t second_mm = images.range_2_mm.empty() ? 0 : images.range_2_mm[index],
                        second_bright = images.range_2_mm.empty() ? 0 : images.reflectivity_2[index];
    std::vector<std::uint32_t> words;
    if (images.profile == kLegacy) words = {mm | 0xA00000u, bright | 500u << 16, 77};  // with flags
    else if (images.profile == kSingle) words = {mm | 0x80000u, bright | 0xEE00u | 500u << 16, 77};
    else if (images.profile == kDual)
        words = {mm | bright << 24, second_mm | second_bright << 24, 0x01F401F4, 77};
    else words = {mm / 8 | 0x8000u | bright << 16 | 0x77000000u};
    if (images.is_dual() && images.is_low_rate())
        words.push_back(second_mm / 8 | second_bright << 16 | (images.range_2_mm.empty() ? 0u : 0x55000000u));
    for (const std::uint32_t word : words) append_raw(bytes, word);
}

std::string make_column_bytes(const OusterImages& images, std::size_t frame, std::size_t column) {
    std::string bytes;
    const bool is_valid = (images.is_valid.empty() || images.is_valid[frame * images.columns + column]) &&
                          images.is_in_window(column);
    append_raw(bytes, images.time_ns[frame * images.columns + column]);
    append_raw(bytes, std::uint16_t(column));
    if (images.profile == kLegacy) {
        append_raw(bytes, std::uint16_t(frame));
        append_raw(bytes, std::uint32_t(column * 90112 / images.columns));
    } else append_raw(bytes, std::uint16_t(is_valid ? 0x0101 : 0x0100));
    for (std::size_t row = 0; row < images.rows; ++row)
        add_pixel(bytes, images, images.at(frame, row, column));
    if (images.profile == kLegacy) append_raw(bytes, std::uint32_t(is_valid ? 0xFFFFFFFF : 0));
    return bytes;
}

std::string read_big_endian(std::uint16_t value) { return {char(value >> 8), char(value & 0xff)}; }

}  // namespace

glm::dvec3 OusterImages::compute_point(std::size_t row, std::size_t column, double mm) const {
    const double encoder = 2.0 * kPi * (1.0 - double(column) / double(columns)),
                 theta = encoder - azimuth_deg[row] * kPi / 180.0, phi = altitude_deg[row] * kPi / 180.0;
    const double n_m = 1e-3 * n_mm, r_m = 1e-3 * mm - n_m;
    return {r_m * std::cos(theta) * std::cos(phi) + n_m * std::cos(encoder),
            r_m * std::sin(theta) * std::cos(phi) + n_m * std::sin(encoder), r_m * std::sin(phi)};
}

std::optional<OusterImages> load_real_images(const std::string& name, const std::string& product,
                                             const std::string& profile) {
    const char* shared = std::getenv("RELIDAR_SHARED");
    const std::filesystem::path file =
        (shared ? std::filesystem::path(shared)
                : std::filesystem::path(RELIDAR_SOURCE_DIR).parent_path() / "shared") /
        "data/ouster" / name;
    if (!std::filesystem::exists(file)) return std::nullopt;
    const std::vector<NamedArray> arrays = read_npz(file);
    const auto array = [&](const char* key) -> const NamedArray& { return *find_array(arrays, key); };
    OusterImages images;
    images.product = product;
    images.profile = profile;
    images.frames = array("range_mm").shape[0];
    images.rows = array("range_mm").shape[1];
    images.columns = array("range_mm").shape[2];
    images.altitude_deg = array("alt").to_doubles();
    images.azimuth_deg = array("az").to_doubles();
    images.n_mm = array("n_mm").to_doubles()[0];
    for (const double mm : array("range_mm").to_doubles())  // low rate: 15 bits in units of 8 mm
        images.range_mm.push_back(images.is_low_rate() && mm > 262136.0 ? 0 : std::uint32_t(mm));
    for (const double v : array("refl").to_doubles()) images.reflectivity.push_back(std::uint32_t(v));
    for (const double ns : array("ts").to_doubles()) images.time_ns.push_back(std::uint64_t(ns));
    if (images.is_dual()) add_second_returns(images);
    return images;
}

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
                append_raw(bytes, std::uint16_t(images.profile == kFusa ? 0xBC01 : 1));
                append_raw(bytes, std::uint16_t(frame));
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
    append_raw(bytes, std::uint32_t(0xA1B23C4D));
    append_raw(bytes, std::uint32_t(0x00040002));
    for (const std::uint32_t word : {0u, 0u, 262144u, 1u}) append_raw(bytes, word);
    for (const Datagram& datagram : datagrams) {
        const std::size_t udp = 8 + datagram.bytes.size(), frame = 14 + 20 + udp;
        append_raw(bytes, std::uint32_t(datagram.stamp_ns / 1000000000));
        append_raw(bytes, std::uint32_t(datagram.stamp_ns % 1000000000));
        append_raw(bytes, std::uint32_t(frame));
        append_raw(bytes, std::uint32_t(frame));
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
