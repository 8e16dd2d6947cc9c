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

constexpr std::uint32_t kPcapMagic = 0xA1B23C4D, kMaxPacketBytes = 262144, kEthernetLink = 1;
constexpr std::size_t kIpBytes = 20, kUdpBytes = 8;

void append_u16(std::string& bytes, unsigned value) {
    bytes += char(value >> 8 & 0xFF);
    bytes += char(value & 0xFF);
}

/// Returns the checksum of an IPv4 header, whose checksum field is 0: the complement of
/// the one's complement sum of its 16-bit numbers (RFC 791).
unsigned compute_checksum(const std::string& header) {
    unsigned sum = 0;
    for (std::size_t i = 0; i + 1 < header.size(); i += 2)
        sum += static_cast<unsigned char>(header[i]) * 256u + static_cast<unsigned char>(header[i + 1]);
    while (sum >> 16) sum = (sum & 0xFFFF) + (sum >> 16);
    return ~sum & 0xFFFF;
}

/// Wraps a UDP datagram in IPv4 and Ethernet headers.
/// @param ip_identification  identification number of the datagram in the IPv4 header
std::string wrap_ethernet(const std::string& payload, int udp_port, unsigned ip_identification) {
    const unsigned udp_length = unsigned(kUdpBytes + payload.size());
    constexpr unsigned kVersionAndLength = 0x4500, kNotFragmented = 0x4000, kTtlAndUdp = 0x4011;
    // version and length, length of the packet, identification, flags, time to live and
    // protocol, checksum, sender, receiver
    std::string ip;
    for (const unsigned value : {kVersionAndLength, unsigned(kIpBytes) + udp_length, ip_identification,
                                 kNotFragmented, kTtlAndUdp, 0u})
        append_u16(ip, value);
    ip += std::string("\xC0\xA8\x01\xC9\xFF\xFF\xFF\xFF", 8);  // 192.168.1.201 to all
    constexpr std::size_t kChecksumAt = 10;
    std::string checksum;
    append_u16(checksum, compute_checksum(ip));
    ip.replace(kChecksumAt, checksum.size(), checksum);
    // receiver (all), sender and the type of IPv4
    std::string frame = std::string("\xFF\xFF\xFF\xFF\xFF\xFF\x02\0\0\0\0\x01\x08\0", 14) + ip;
    append_u16(frame, unsigned(udp_port));  // of the sender
    append_u16(frame, unsigned(udp_port));  // of the receiver
    append_u16(frame, udp_length);
    append_u16(frame, 0);  // no UDP checksum
    return frame + payload;
}

void check_written(const std::ofstream& stream, const fs::path& file) {
    if (!stream) fail("cannot write '{}'; the disk may be full", file.string());
}

}  // namespace

std::string read_udp_profile(const fs::path& metadata_file) {
    std::error_code failed;
    if (!fs::is_regular_file(metadata_file, failed) || metadata_file.extension() != ".json") return {};
    const std::string text = read_text_file(metadata_file);
    if (!packets::is_metadata(text)) return {};
    return packets::parse_metadata(text, metadata_file.string())->profile->name;
}

PcapWriter::PcapWriter(const fs::path& file, int port)
    : file_(file), out_(file, std::ios::binary), port_(port) {
    std::string head;
    constexpr std::uint32_t kVersion_2_4 = 2 | 4 << 16;
    for (const std::uint32_t value : {kPcapMagic, kVersion_2_4, 0u, 0u, kMaxPacketBytes, kEthernetLink})
        append_raw(head, value);
    out_ << head;
    check_written(out_, file_);
}

void PcapWriter::write_packets(const std::vector<SensorPacket>& packets) {
    constexpr std::int64_t kNsPerSecond = 1'000'000'000;
    for (const SensorPacket& packet : packets) {
        const std::string frame = wrap_ethernet(packet.bytes, port_, n_written_++);
        // Header of a record: seconds, nanoseconds, stored length, original length.
        std::string head;
        for (const auto value : {packet.time_ns / kNsPerSecond, packet.time_ns % kNsPerSecond,
                                 std::int64_t(frame.size()), std::int64_t(frame.size())})
            append_raw(head, std::uint32_t(value));
        out_ << head << frame;
    }
    check_written(out_, file_);
}

void PcapWriter::close_file() {
    out_.close();
    check_written(out_, file_);
}

std::size_t save_packets(const Log& log, const fs::path& file, const Progress& progress) {
    if (log.lidars.size() != 1)
        fail<UsageError>("cannot write '{}': found {} LiDARs, expected one; select it with dataset.lidars",
                         file.string(), log.lidars.size());
    PacketOptions options;
    options.start_ns = time_shift_of(log);
    // Firings are counted by azimuth, because times of a log can be arrival times.
    options.times_jitter = true;
    for (const Frame& frame : log.frames)
        if (!frame.scan.second_returns.empty()) options.returns = 2;
    PacketEncoder encoder(log.lidars.front().sensor, options);
    std::size_t n_packets = 0;
    write_atomically(file, [&](const fs::path& temporary) {
        PcapWriter capture(temporary, encoder.udp_port());
        const auto add = [&](const std::vector<SensorPacket>& packets) {
            capture.write_packets(packets);
            n_packets += packets.size();
        };
        for (std::size_t f = 0; f < log.frames.size(); ++f) {
            if (progress) progress("writing packets", double(f) / double(log.frames.size()));
            add(encoder.add_scan(log.frames[f].scan, log.frames[f].time_s));
        }
        // The encoder keeps incomplete packets until flush().
        add(encoder.flush());
        capture.close_file();
    });
    const PacketCalibrationFile calibration = encoder.calibration_file();
    if (!calibration.ending.empty())
        write_text_file(fs::path(file).replace_extension(calibration.ending), calibration.text);
    return n_packets;
}

}  // namespace relidar
