// SPDX-License-Identifier: Apache-2.0
#include "simulate/scan_files/scan_folder.hpp"

#include <system_error>

#include <relidar/simulate/render.hpp>

namespace relidar::scan_files {
namespace {

namespace fs = std::filesystem;

constexpr const char* kPacketsStem = "packets";

}  // namespace

PacketFileWriter::PacketFileWriter(fs::path folder, const std::vector<ScanOutputOptions>& sensors)
    : packets_(sensors) {
    for (std::size_t s = 0; s < sensors.size(); ++s) {
        std::string name = kPacketsStem;
        if (sensors.size() > 1) name += "_" + to_topic_name(sensors[s].frame_id);
        const fs::path path = folder / (name + ".pcap"), temporary = make_temp_path(path);
        files_.push_back({path, temporary, PcapWriter(temporary, packets_.encoder(s).udp_port())});
    }
}

PacketFileWriter::~PacketFileWriter() {
    std::error_code failed;
    for (const OpenPacketFile& file : files_) fs::remove(file.temporary, failed);
}

void PacketFileWriter::write_packets(const std::vector<std::vector<SensorPacket>>& packets) {
    for (std::size_t s = 0; s < packets.size(); ++s) files_[s].capture.write_packets(packets[s]);
}

void PacketFileWriter::write(std::span<const RenderedScan> scans) { write_packets(packets_.encode(scans)); }

/// Writes the packets that are not complete yet, and the calibrations of the sensors.
void PacketFileWriter::finish_writing() {
    write_packets(packets_.flush());
    for (std::size_t s = 0; s < files_.size(); ++s) {
        // A file gets its final name only when it is complete.
        OpenPacketFile& file = files_[s];
        file.capture.close_file();
        write_atomically(file.path, [&](const fs::path& target) { fs::rename(file.temporary, target); });
        const PacketCalibrationFile calibration = packets_.encoder(s).calibration_file();
        if (calibration.ending.empty()) continue;
        calibrations_.push_back(fs::path(file.path).replace_extension(calibration.ending));
        write_text_file(calibrations_.back(), calibration.text);
    }
}

std::vector<std::string> PacketFileWriter::file_names() const {
    std::vector<std::string> names;
    for (const OpenPacketFile& file : files_) names.push_back(file.path.filename().string());
    for (const fs::path& file : calibrations_) names.push_back(file.filename().string());
    return names;
}

bool PacketFileWriter::is_packet_file(const fs::path& file_name) {
    const std::string stem = file_name.stem().string(), ending = file_name.extension().string();
    return (stem == kPacketsStem || stem.starts_with(std::string(kPacketsStem) + "_")) &&
           (ending == ".pcap" || ending == ".json" || ending == ".csv");
}

}  // namespace relidar::scan_files
