// SPDX-License-Identifier: Apache-2.0
// Writes network captures in the pcap format with nanoseconds (draft-ietf-opsawg-pcap).
// Each packet becomes an Ethernet frame with IPv4 and UDP. Also writes all scans of a log
// as one capture.
#include <bit>
#include <system_error>

#include <relidar/base/files.hpp>
#include <relidar/log/log_time.hpp>
#include <relidar/read/packets.hpp>

#include "base/bytes.hpp"
#include "base/csv.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"
#include "read/packets/ouster.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

constexpr std::uint32_t kMagic = 0xA1B23C4D, kMostBytes = 262144, kEthernetLink = 1;
constexpr std::size_t kIpBytes = 20, kUdpBytes = 8;

void append_uint16_big_endian(std::string& bytes, unsigned value) {
    bytes += char(value >> 8 & 0xFF);
    bytes += char(value & 0xFF);
}

/// Wraps a UDP datagram in IPv4 and Ethernet headers.
/// @param ip_identification  identification number of the datagram in the IPv4 header
std::string wrap_in_ethernet_frame(const std::string& payload, int udp_port, unsigned ip_identification) {
    std::string ip;
    for (const unsigned value :
         {0x4500u, unsigned(kIpBytes + kUdpBytes + payload.size()), ip_identification, 0x4000u, 0x4011u, 0u})
        append_uint16_big_endian(ip, value);
    ip += std::string("\xC0\xA8\x01\xC9\xFF\xFF\xFF\xFF", 8);  // 192.168.1.201 to all
    // checksum of the IPv4 header (RFC 791)
    unsigned sum = 0;
    for (std::size_t i = 0; i + 1 < ip.size(); i += 2)
        sum += static_cast<unsigned char>(ip[i]) * 256u + static_cast<unsigned char>(ip[i + 1]);
    while (sum >> 16) sum = (sum & 0xFFFF) + (sum >> 16);
    const unsigned checksum = ~sum & 0xFFFF;
    ip[10] = char(checksum >> 8);
    ip[11] = char(checksum & 0xFF);
    std::string frame = std::string("\xFF\xFF\xFF\xFF\xFF\xFF\x02\0\0\0\0\x01\x08\0", 14) + ip;
    append_uint16_big_endian(frame, unsigned(udp_port));
    append_uint16_big_endian(frame, unsigned(udp_port));
    append_uint16_big_endian(frame, unsigned(kUdpBytes + payload.size()));
    append_uint16_big_endian(frame, 0);
    return frame + payload;
}

void require_successful_write(const std::ofstream& stream, const fs::path& file) {
    if (!stream) fail("cannot write '{}'; the disk may be full", file.string());
}

}  // namespace

std::string read_ouster_packet_format(const fs::path& metadata_file) {
    std::error_code failed;
    if (!fs::is_regular_file(metadata_file, failed) || metadata_file.extension() != ".json") return {};
    const std::string text = read_text_file(metadata_file);
    if (!packets::is_ouster_metadata(text)) return {};
    return packets::parse_ouster_metadata(text, metadata_file.string())->profile->name;
}

PcapWriter::PcapWriter(const fs::path& file, int port)
    : file_(file), out_(file, std::ios::binary), port_(port) {
    std::string head;
    constexpr std::uint32_t kVersion_2_4 = 2 | 4 << 16;
    for (const std::uint32_t value : {kMagic, kVersion_2_4, 0u, 0u, kMostBytes, kEthernetLink})
        append_binary_value(head, value);
    out_ << head;
    require_successful_write(out_, file_);
}

void PcapWriter::write_packets(const std::vector<SensorPacket>& packets) {
    constexpr std::int64_t kSecond = 1'000'000'000;
    for (const SensorPacket& packet : packets) {
        const std::string frame = wrap_in_ethernet_frame(packet.bytes, port_, n_written_++);
        std::string head;
        for (const auto value : {packet.time_ns / kSecond, packet.time_ns % kSecond,
                                 std::int64_t(frame.size()), std::int64_t(frame.size())})
            append_binary_value(head, std::uint32_t(value));
        out_ << head << frame;
    }
    require_successful_write(out_, file_);
}

void PcapWriter::close_file() {
    out_.close();
    require_successful_write(out_, file_);
}

std::size_t save_packets(const LidarSequence& sequence, const fs::path& file,
                         const ProgressReporter& progress) {
    if (sequence.lidars.size() != 1)
        fail<UsageError>("cannot write '{}': found {} LiDARs, expected one; select it with dataset.lidars",
                         file.string(), sequence.lidars.size());
    PacketOptions options;
    options.start_ns = compute_time_shift_ns(sequence);
    options.times_jitter = true;
    for (const LidarFrame& frame : sequence.frames)
        if (!frame.scan.second_returns.empty()) options.returns = 2;
    PacketEncoder encoder(sequence.lidars.front().sensor, options);
    std::size_t n_packets = 0;
    write_file_atomically(file, [&](const fs::path& temporary) {
        PcapWriter capture(temporary, encoder.get_udp_port());
        const auto add = [&](const std::vector<SensorPacket>& packets) {
            capture.write_packets(packets);
            n_packets += packets.size();
        };
        for (std::size_t f = 0; f < sequence.frames.size(); ++f) {
            if (progress) progress("writing packets", double(f) / double(sequence.frames.size()));
            add(encoder.encode_scan_as_packets(sequence.frames[f].scan, sequence.frames[f].time_s));
        }
        add(encoder.flush_remaining_packets());
        capture.close_file();
    });
    if (const PacketCalibrationFile calibration = encoder.get_packet_calibration();
        !calibration.ending.empty())
        write_text_file(fs::path(file).replace_extension(calibration.ending), calibration.text);
    return n_packets;
}

}  // namespace relidar
