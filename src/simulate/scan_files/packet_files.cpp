// SPDX-License-Identifier: Apache-2.0
#include "packet_files.hpp"

#include <system_error>

#include <relidar/base/files.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar::scan_files {
namespace {

namespace fs = std::filesystem;

constexpr const char* kPacketsStem = "packets";

}  // namespace

PacketFiles::PacketFiles(fs::path folder, const std::vector<ScanFormat>& sensors) : packets_(sensors) {
    for (std::size_t s = 0; s < sensors.size(); ++s) {
        std::string name = kPacketsStem;
        if (sensors.size() > 1) name += "_" + make_topic_word(sensors[s].frame_id);
        const fs::path path = folder / (name + ".pcap"), temporary = make_temporary_path(path);
        files_.push_back({path, temporary, PacketCapture(temporary, packets_.encoder(s).port() + int(s))});
    }
}

PacketFiles::~PacketFiles() {
    std::error_code failed;
    for (const File& file : files_) fs::remove(file.temporary, failed);
}

void PacketFiles::write(const std::vector<std::vector<SensorPacket>>& packets) {
    for (std::size_t s = 0; s < packets.size(); ++s) files_[s].capture.add(packets[s]);
}

void PacketFiles::add(std::span<const RenderedScan> scans) { write(packets_.encode(scans)); }

void PacketFiles::finish() {
    write(packets_.finish());
    for (std::size_t s = 0; s < files_.size(); ++s) {
        File& file = files_[s];
        file.capture.close();
        write_atomically(file.path, [&](const fs::path& target) { fs::rename(file.temporary, target); });
        const PacketCalibration calibration = packets_.encoder(s).calibration();
        if (!calibration.ending.empty())
            write_text(fs::path(file.path).replace_extension(calibration.ending), calibration.text);
    }
}

std::vector<std::string> PacketFiles::names() const {
    std::vector<std::string> names;
    for (const File& file : files_) names.push_back(file.path.filename().string());
    return names;
}

bool PacketFiles::is_file(const fs::path& name) {
    const std::string stem = name.stem().string(), ending = name.extension().string();
    return (stem == kPacketsStem || stem.starts_with(std::string(kPacketsStem) + "_")) &&
           (ending == ".pcap" || ending == ".json" || ending == ".csv");
}

}  // namespace relidar::scan_files
