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
    const bool is_small_csv = find_name(file.extension().string(), {".csv"}) &&
                              fs::is_regular_file(file, failed) &&
                              fs::file_size(file, failed) <= kMostCorrectionBytes;
    if (!is_small_csv) return false;
    const std::vector<std::string> lines = split_lines(read_file(file));
    if (lines.empty()) return false;
    // "Laser id,Elevation,Azimuth" or "Channel,Elevation,Azimuth"
    const std::vector<std::string_view> header = split_csv_cells(lines.front());
    return header.size() >= 3 && find_name(header[1], {"elevation"}) && find_name(header[2], {"azimuth"});
}

/// Reads the angle correction files in a folder. A damaged one has an error, no lasers.
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
            corrections.push_back({.where = file.filename().string(), .lasers = {}, .problem = error.what()});
        }
    }
}

}  // namespace

AngleCorrection parse_angles(const std::string& csv_text, const std::string& where) {
    std::map<std::size_t, LaserAngles> angles_of_laser;  // laser numbers begin with 1
    for (const std::string& line : split_lines(csv_text)) {
        const std::vector<std::string_view> cells = split_csv_cells(line);
        const std::optional<double> laser = cells.size() < 3 ? std::nullopt : parse_number(cells[0]);
        if (!laser) continue;  // the header, or the line with the checksum
        const std::optional<double> elevation_deg = parse_number(cells[1]);
        const std::optional<double> azimuth_deg = parse_number(cells[2]);
        const bool is_laser = *laser >= 1.0 && *laser <= kMostCorrectedLasers;
        const bool are_angles = elevation_deg && azimuth_deg && std::abs(*elevation_deg) <= 90.0 &&
                                std::abs(*azimuth_deg) <= 180.0;
        if (!is_laser || !are_angles)
            fail("{}: found the line '{}', expected the number of a laser, its elevation and its azimuth",
                 where, quote(line));
        angles_of_laser[std::size_t(*laser)] = {*elevation_deg, *azimuth_deg};
    }
    AngleCorrection correction{.where = where, .lasers = {}};
    for (const auto& [laser, angles] : angles_of_laser) {
        const std::size_t expected_laser = correction.lasers.size() + 1;
        if (laser != expected_laser)
            fail("{}: the angles of laser {} are missing, expected the angles of all lasers up to {}", where,
                 expected_laser, angles_of_laser.rbegin()->first);
        correction.lasers.push_back(angles);
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
