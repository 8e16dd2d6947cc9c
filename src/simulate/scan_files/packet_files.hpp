// SPDX-License-Identifier: Apache-2.0
// Writes the network packets of all sensors as capture files. The name is packets.pcap,
// or packets_NAME.pcap for each sensor of a rig. A file with the same name and the
// extension .csv or .json contains the calibration that drivers need.
#pragma once

#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include <relidar/simulate/scan_packets.hpp>

namespace relidar::scan_files {

/// Name of the output format that contains network packets.
inline constexpr const char* kPacketFormat = "pcap";

class PacketFiles {
public:
    /// Creates the capture files under temporary names.
    /// @throws UsageError if relidar cannot write packets of a sensor
    PacketFiles(std::filesystem::path folder, const std::vector<ScanFormat>& sensors);
    /// Removes the temporary files if finish() was not called.
    ~PacketFiles();
    PacketFiles(const PacketFiles&) = delete;
    PacketFiles& operator=(const PacketFiles&) = delete;

    void add(std::span<const RenderedScan> scans);
    void finish();
    std::vector<std::string> names() const;
    /// Returns true if this class may have written a file with this name.
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
