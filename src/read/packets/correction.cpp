// SPDX-License-Identifier: Apache-2.0
#include "read/packets/decoder.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <system_error>

#include "base/csv.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"

namespace relidar::packets {
namespace {

namespace fs = std::filesystem;

constexpr std::uintmax_t kMostCorrectionBytes = 65536;
constexpr std::size_t kMostCorrections = 64;
constexpr double kMostCorrectedLasers = 1024.0;

/// Returns true if a file is a small CSV table with the columns of an angle correction.
bool is_angle_file(const fs::path& file) {
    std::error_code failed;
    if (!find_name(file.extension().string(), {".csv"}) || !fs::is_regular_file(file, failed) ||
        fs::file_size(file, failed) > kMostCorrectionBytes)
        return false;
    const std::vector<std::string> lines = split_lines(read_file(file));
    if (lines.empty()) return false;
    const std::vector<std::string_view> header = split_csv_cells(lines.front());
    return header.size() >= 3 && find_name(header[1], {"elevation"}) && find_name(header[2], {"azimuth"});
}

/// Reads all angle correction files in a folder. A damaged file is added with its error
/// instead of lasers.
void add_angle_files(const fs::path& folder, std::vector<AngleCorrection>& corrections) {
    std::vector<fs::path> files;
    std::error_code failed;
    for (fs::directory_iterator at(folder, failed), end; !failed && at != end; at.increment(failed))
        files.push_back(at->path());
    std::ranges::sort(files);
    for (const fs::path& file : files) {
        try {
            if (corrections.size() < kMostCorrections && is_angle_file(file))
                corrections.push_back(parse_angles(read_text_file(file), file.filename().string()));
        } catch (const DataError& error) {
            corrections.push_back({file.filename().string(), false, {}, error.what()});
        }
    }
}

}  // namespace

AngleCorrection parse_angles(const std::string& csv_text, const std::string& where) {
    std::map<std::size_t, LaserAngles> angles;
    for (const std::string& line : split_lines(csv_text)) {
        const std::vector<std::string_view> cells = split_csv_cells(line);
        const auto laser = parse_number(cells[0]);
        if (!laser || cells.size() < 3) continue;  // skips the header and the checksum line
        const auto elevation = parse_number(cells[1]), azimuth = parse_number(cells[2]);
        if (!(*laser >= 1.0 && *laser <= kMostCorrectedLasers) || !elevation || !azimuth ||
            !(std::abs(*elevation) <= 90.0) || !(std::abs(*azimuth) <= 180.0))
            fail("{}: found the line '{}', expected the number of a laser, its elevation and its azimuth",
                 where, quote(line));
        angles[std::size_t(*laser)] = {*elevation, *azimuth};
    }
    AngleCorrection correction{where, false, {}};
    for (const auto& [laser, laser_angles] : angles) {
        correction.lasers.push_back(laser_angles);
        // The map is sorted by laser number, from 1. After a missing laser, the number
        // exceeds the size of the list.
        if (laser != correction.lasers.size())
            fail("{}: the angles of laser {} are missing, expected the angles of all lasers up to {}", where,
                 correction.lasers.size(), angles.rbegin()->first);
    }
    return correction;
}

std::vector<AngleCorrection> find_angle_files(const std::vector<fs::path>& recording_files) {
    std::set<fs::path> named, folders;
    for (const fs::path& file : recording_files) {
        const fs::path folder = fs::absolute(file).parent_path();
        std::vector<fs::path> candidates{fs::path(file).replace_extension(".csv")};
        folders.insert(folder);
        if (does_path_exist(folder / "metadata.yaml")) {
            // For a ROS 2 bag, the file FOLDER.csv next to the folder counts too.
            candidates.push_back(fs::path(folder).concat(".csv"));
            folders.insert(folder.parent_path());
        }
        const auto match = std::ranges::find_if(candidates, is_angle_file);
        if (match != candidates.end()) named.insert(*match);
    }
    std::vector<AngleCorrection> corrections;
    for (const fs::path& file : named) {
        corrections.push_back(parse_angles(read_text_file(file), file.filename().string()));
        corrections.back().is_named = true;
    }
    if (!corrections.empty()) return corrections;
    for (const fs::path& folder : folders) add_angle_files(folder, corrections);
    return corrections;
}

}  // namespace relidar::packets
