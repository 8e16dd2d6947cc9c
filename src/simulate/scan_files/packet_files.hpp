// SPDX-License-Identifier: Apache-2.0
// Writes the packets of all sensors of a rendering as captures: packets.pcap, or for the
// sensors of a rig packets_NAME.pcap. The calibration that drivers need has the same name
// and the ending .csv or .json.
#pragma once

#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include <relidar/simulate/scan_packets.hpp>

namespace relidar::scan_files {

/// Name of the format that stores packets.
inline constexpr const char* kPacketFormat = "pcap";

class PacketFiles {
public:
    /// Creates the captures with temporary names.
    /// @throws UsageError if packets of a sensor cannot be written
    PacketFiles(std::filesystem::path folder, const std::vector<ScanFormat>& sensors);
    /// Removes the captures if finish() was not called.
    ~PacketFiles();
    PacketFiles(const PacketFiles&) = delete;
    PacketFiles& operator=(const PacketFiles&) = delete;

    void add(std::span<const RenderedScan> scans);
    void finish();
    std::vector<std::string> names() const;
    /// Returns true if a file may be a file of this class.
    static bool is_file(const std::filesystem::path& name);

private:
    struct File {
        std::filesystem::path path, temporary;
        PacketCapture capture;
    };
    ScanPackets packets_;
    std::vector<File> files_;

    void write(const std::vector<std::vector<SensorPacket>>& packets);
};

}  // namespace relidar::scan_files
