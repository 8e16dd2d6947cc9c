// SPDX-License-Identifier: Apache-2.0
// Writes scans as the packets that a LiDAR sends. Rounding, block order, firing times and
// packet counters follow the manuals. load_log() can read these packets.
#pragma once

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include <relidar/base/progress.hpp>
#include <relidar/log/log.hpp>
#include <relidar/log/sensor.hpp>

namespace relidar {

/// A datagram of a LiDAR.
struct SensorPacket {
    /// Time since 1970. Velodyne and Hesai QT64: of the first firing. Other Hesai: after
    /// the last firing. Ouster: of the last column.
    std::int64_t time_ns = 0;
    std::string bytes;
};

struct PacketOptions {
    std::int64_t start_ns = 0;  ///< time since 1970 that corresponds to time 0 of the log
    int returns = 1;            ///< returns per ray, 1 or 2
    /// Packet format of an Ouster (udp_profile_lidar). Empty: RNG19_RFL8_SIG16_NIR16, or
    /// RNG19_RFL8_SIG16_NIR16_DUAL for two returns per ray.
    std::string ouster_profile = {};
    /// Number of earlier sensors in a rig, either of those by Ouster or of all others.
    /// Each sensor has a pair of UDP ports, and the pairs follow each other.
    int unit = 0;
    /// True: the times of the scans jitter, because a computer stamped the packets when
    /// they arrived. Firings are then counted by their azimuths instead of their times.
    bool times_jitter = false;
};

/// A file that drivers need in addition to the packets.
struct PacketCalibrationFile {
    std::string ending;  ///< ".csv" or ".json"; empty if the packets need no such file
    std::string text;
};

/// Returns the names of the sensors whose packets can be written, for messages.
std::string packet_sensors();
/// Returns the maker of a sensor whose packets can be written.
std::string packet_maker(const std::string& sensor_name);
/// Returns the packet format (udp_profile_lidar) in the metadata of an Ouster, or an
/// empty text if the file is something else.
std::string read_udp_profile(const std::filesystem::path& metadata_file);

/// Converts the scans of a sensor to packets. A packet holds a fixed number of firings,
/// so it may contain the end of one scan and the start of the next. Drivers detect the
/// end of a scan by an extra packet without returns after the last scan and before a long
/// gap.
class PacketEncoder {
public:
    /// Creates an encoder for the packets of one sensor.
    /// @param sensor  sensor whose name selects the packet format
    /// @throws UsageError if packets of this sensor cannot be written. The message lists
    /// the sensors that can be written.
    PacketEncoder(const SpinningSensor& sensor, const PacketOptions& options);
    ~PacketEncoder();

    /// Adds a scan. Returns the packets that are now complete.
    /// @param scan  scan of the sensor in image order (RayTable)
    /// @param time_s  reference time of the scan; must not be earlier than the time of
    /// the previous scan
    /// @throws UsageError if the rays have no firing times or do not belong to the
    /// sensor. Also if a ray was fired before the end of the previous scan
    std::vector<SensorPacket> add_scan(const Scan& scan, double time_s);
    /// Returns the remaining packets, after the last scan.
    std::vector<SensorPacket> flush();
    /// Returns the calibration that belongs to the packets. Must be called after the last
    /// scan, because the calibration of an Ouster contains the azimuths of all firings.
    PacketCalibrationFile calibration_file() const;
    /// UDP port of the packets: 2368 for Velodyne and Hesai, 7502 for Ouster, plus two
    /// for each earlier unit of the maker. The next port is that of the sensor's other
    /// packets.
    int udp_port() const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Writes a network capture (pcap with nanoseconds). Each packet is a UDP datagram from
/// 192.168.1.201 to all receivers.
class PcapWriter {
public:
    /// Creates the file.
    /// @param port  destination port of the datagrams
    /// @throws DataError if the file cannot be written
    PcapWriter(const std::filesystem::path& file, int port);
    /// Appends packets to the file.
    /// @throws DataError if the disk is full
    void write_packets(const std::vector<SensorPacket>& packets);
    void close_file();

private:
    std::filesystem::path file_;
    std::ofstream out_;
    int port_;
    std::uint16_t n_written_ = 0;
};

/// Writes the scans of a log as a network capture of LiDAR packets. The log must have a
/// single LiDAR. The calibration is written to a second file with the same name and the
/// ending .csv or .json.
/// @return number of packets
/// @throws UsageError if the log has several LiDARs, or in the same cases as
/// PacketEncoder
/// @throws DataError if a file cannot be written
std::size_t save_packets(const Log& log, const std::filesystem::path& file, const Progress& progress = {});

}  // namespace relidar
