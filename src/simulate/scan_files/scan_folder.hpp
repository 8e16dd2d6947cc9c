// SPDX-License-Identifier: Apache-2.0
// Declares the parts of a folder of scans: the entries of scans.json, and capture files
// with the network packets of all sensors. Private to scan_files.
#pragma once

#include <relidar/simulate/scan_files.hpp>
#include <relidar/simulate/scan_packets.hpp>

namespace relidar::scan_files {

/// Returns the description of a scan in scans.json, as one line. Has the boxes of actors
/// if their visibility was computed.
std::string entry_json(int frame, const RenderedScan& scan, const ScanOutputOptions& format,
                       const std::vector<std::string>& files);

/// Removes the files of an earlier rendering, and half-written files of a killed process.
/// @throws UsageError if the folder has scans that no scans.json lists
/// @throws DataError if a file cannot be removed
void remove_scans(const std::filesystem::path& folder);
/// Writes scans.json for a folder with recordings but without single scans.
void write_recordings(const std::filesystem::path& folder, const std::vector<std::string>& names);

inline constexpr const char* kDepthEnding = "_depth";  ///< end of the stem of a camera's depth file
inline constexpr const char* kPacketFormat = "pcap";
inline constexpr const char* kPacketHelp =
    R"(DIR/packets.pcap, the packets that the sensor sends, with its rounding and timing; with
packets.csv (Hesai) or packets.json (Ouster), the calibration for its driver.)";

/// Writes packets.pcap, or packets_NAME.pcap for each sensor of a rig. A file with the
/// same name and the extension .csv or .json contains the calibration that drivers need.
class PacketFileWriter {
public:
    /// The files have temporary names until finish_writing().
    /// @throws UsageError if relidar cannot write packets of a sensor
    PacketFileWriter(std::filesystem::path folder, const std::vector<ScanOutputOptions>& sensors);
    ~PacketFileWriter();
    PacketFileWriter(const PacketFileWriter&) = delete;
    PacketFileWriter& operator=(const PacketFileWriter&) = delete;

    void write(std::span<const RenderedScan> scans);
    void finish_writing();
    std::vector<std::string> file_names() const;
    static bool is_packet_file(const std::filesystem::path& name);

private:
    struct OpenPacketFile {
        std::filesystem::path path, temporary;
        PcapWriter capture;
    };
    ScanPacketEncoder packets_;
    std::vector<OpenPacketFile> files_;
    std::vector<std::filesystem::path> calibrations_;

    void write_packets(const std::vector<std::vector<SensorPacket>>& packets_per_sensor);
};

}  // namespace relidar::scan_files
