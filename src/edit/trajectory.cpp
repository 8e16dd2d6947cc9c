// SPDX-License-Identifier: Apache-2.0
// Trajectories as CSV, for tools that plan them.
#include <relidar/edit.hpp>

#include <array>
#include <cmath>

#include <fmt/format.h>

#include "core/files.hpp"
#include <relidar/error.hpp>

namespace relidar {

namespace {

constexpr std::array kColumns{"time_s", "x", "y", "z", "yaw_deg", "pitch_deg", "roll_deg"};
constexpr std::size_t kNeeded = 5;
constexpr double kLargest = 1e10;   // metres of any world, degrees, and seconds since 1970

std::vector<std::string> cells_of(const std::string& line) {
    std::vector<std::string> cells{""};
    for (const char c : line) {
        if (c == ',' && cells.size() <= kColumns.size()) cells.emplace_back();   // one too many is enough to be refused
        else cells.back() += c;
    }
    return cells;
}

/// Numbers of a line. @throws DataError for the first cell that is none, with the name of its column
std::vector<double> read_row(const std::vector<std::string>& cells, const std::string& where) {
    if (cells.size() < kNeeded || cells.size() > kColumns.size())
        throw DataError(
            fmt::format("{}: found {} columns, expected time_s,x,y,z,yaw_deg and optionally pitch_deg,roll_deg", where, cells.size()));
    std::vector<double> row;
    for (std::size_t i = 0; i < cells.size(); ++i) {
        const std::optional<double> value = parse_number(trimmed(cells[i]));
        if (!value || !(std::abs(*value) <= kLargest))
            throw DataError(fmt::format("{}: {}: found \"{}\", expected a finite number within {:.0e}", where, kColumns[i],
                                        excerpt(trimmed(cells[i])), kLargest));
        row.push_back(*value);
    }
    row.resize(kColumns.size(), 0.0);
    return row;
}

Pose pose_of(const std::vector<double>& row) {
    const double radians = kPi / 180.0;
    return {rotation_of(row[4] * radians, row[5] * radians, row[6] * radians), {row[1], row[2], row[3]}};
}

}  // namespace

PoseTrack read_trajectory(const std::filesystem::path& path) {
    const std::vector<std::string> lines = split_lines(read_file(path));
    PoseTrack track;
    for (std::size_t i = 0; i < lines.size(); ++i) {
        const std::vector<std::string> cells = cells_of(lines[i]);
        const std::string where = fmt::format("{}: line {}", path.string(), i + 1);
        if (trimmed(lines[i]).empty() || (i == 0 && trimmed(cells[0]) == kColumns[0])) continue;
        const std::vector<double> row = read_row(cells, where);
        if (!track.time_s.empty() && !(row[0] > track.time_s.back()))
            throw DataError(fmt::format("{}: time_s: found {} after {}, expected times that rise", where, row[0], track.time_s.back()));
        track.time_s.push_back(row[0]);
        track.pose.push_back(pose_of(row));
    }
    if (track.pose.size() < 2) throw DataError(fmt::format("{}: found {} poses, expected at least two", path.string(), track.pose.size()));
    return track;
}

}  // namespace relidar
