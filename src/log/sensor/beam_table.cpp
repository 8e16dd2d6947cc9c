// SPDX-License-Identifier: Apache-2.0
// Reads beam tables in CSV format: a header line, then one line per beam. An unknown
// column is an error, because it can be a misspelt name.
#include <relidar/log/sensor.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>
#include "base/csv.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"

namespace relidar {
namespace {

constexpr double kFarthestLimit_m = 10'000.0;

/// Values of a line. A missing column has the value of this struct.
struct BeamRow {
    double elevation_deg = 0.0, azimuth_offset_deg = 0.0;
    double origin_offset_m = 0.0, origin_up_m = 0.0, origin_left_m = 0.0;
    double firing_offset_us = 0.0;
    double min_range_m = 0.0, max_range_m = RangeLimits{}.max_m;
    double channel = 0.0;
};

struct BeamColumn {
    const char* name;
    double BeamRow::*member;
    double low, high;  ///< allowed values
};
constexpr BeamColumn kBeamColumns[] = {{"elevation_deg", &BeamRow::elevation_deg, -90.0, 90.0},
                                       {"azimuth_offset_deg", &BeamRow::azimuth_offset_deg, -180.0, 180.0},
                                       {"origin_offset_m", &BeamRow::origin_offset_m, -10.0, 10.0},
                                       {"origin_up_m", &BeamRow::origin_up_m, -10.0, 10.0},
                                       {"origin_left_m", &BeamRow::origin_left_m, -10.0, 10.0},
                                       {"firing_offset_us", &BeamRow::firing_offset_us, 0.0, 1e6},
                                       {"min_range_m", &BeamRow::min_range_m, 0.0, kFarthestLimit_m},
                                       {"max_range_m", &BeamRow::max_range_m, 0.0, kFarthestLimit_m},
                                       {"channel", &BeamRow::channel, 0.0, 65535.0}};

/// Returns the values of one beam.
/// @param column_indices  cell of each of kBeamColumns; -1: the file has no such column
BeamRow parse_beam_row(const std::vector<std::string_view>& cells, const std::vector<int>& column_indices,
                       const std::string& where) {
    BeamRow row;
    for (std::size_t k = 0; k < std::size(kBeamColumns); ++k) {
        if (column_indices[k] < 0) continue;
        const BeamColumn& column = kBeamColumns[k];
        const std::string_view cell = cells[std::size_t(column_indices[k])];
        const auto number = parse_number(cell);
        if (!number || !(*number >= column.low && *number <= column.high))
            fail("{}: {} is '{}', expected a number in [{}, {}]", where, column.name, cell, column.low,
                 column.high);
        row.*column.member = *number;
    }
    return row;
}

/// Adds the beam in one line of a beam table to a sensor.
/// @throws DataError if the beam is higher than the previous one, or if its range limits
/// differ from the first line
void append_beam(SpinningSensor& sensor, const BeamRow& row, const std::string& where) {
    // The head turns on between the nominal time and the firing. The rotation is
    // negative, because the head turns clockwise.
    const double turned_rad = -2.0 * kPi / sensor.period_s * row.firing_offset_us * 1e-6;
    const Beam beam{.elevation_rad = row.elevation_deg * kPi / 180.0,
                    .azimuth_offset_rad = row.azimuth_offset_deg * kPi / 180.0 + turned_rad,
                    .origin_offset_m = row.origin_offset_m,
                    .origin_up_m = row.origin_up_m,
                    .origin_left_m = row.origin_left_m};
    if (sensor.beams.empty()) {
        sensor.min_range_m = row.min_range_m;
        sensor.max_range_m = row.max_range_m;
    }
    if (row.min_range_m != sensor.min_range_m || row.max_range_m != sensor.max_range_m)
        fail(
            "{}: found range limits of {} to {} m, expected {} to {} m like in the first line, because all "
            "beams have the same limits",
            where, row.min_range_m, row.max_range_m, sensor.min_range_m, sensor.max_range_m);
    if (!(row.min_range_m < row.max_range_m))
        fail("{}: found range limits of {} to {} m, expected min_range_m below max_range_m", where,
             row.min_range_m, row.max_range_m);
    if (!sensor.beams.empty() && beam.elevation_rad > sensor.beams.back().elevation_rad)
        fail("{}: elevation_deg increases, expected rows from the highest beam to the lowest", where);
    sensor.beams.push_back(beam);
}

}  // namespace

SpinningSensor parse_beams(const std::string& text, const std::string& where, int n_columns, double rate_hz) {
    const std::vector<std::string> lines = split_lines(text);
    const auto is_comment = [](const std::string& line) { return line.starts_with('#'); };
    const auto header_line = std::size_t(std::ranges::find_if_not(lines, is_comment) - lines.begin());
    std::vector<std::string_view> header;
    if (header_line < lines.size()) header = split_csv_cells(lines[header_line]);
    std::vector<std::string> column_names;
    for (const BeamColumn& column : kBeamColumns) column_names.emplace_back(column.name);
    const std::vector<int> column_indices =
        find_columns(header, column_names, fmt::format("{} line {}", where, header_line + 1));
    if (column_indices[0] < 0)  // the first of kBeamColumns
        fail("{}: the first line has no column 'elevation_deg', expected a CSV beam table", where);

    SpinningSensor sensor;
    sensor.columns = n_columns;
    sensor.period_s = 1.0 / rate_hz;
    // Half a column from the rear, so that the columns are symmetric to the front.
    sensor.first_azimuth_rad = kPi - kPi / n_columns;
    for (std::size_t l = header_line + 1; l < lines.size(); ++l) {
        if (trim(lines[l]).empty() || is_comment(lines[l])) continue;
        const std::string line = fmt::format("{} line {}", where, l + 1);
        const auto cells = split_csv_cells(lines[l]);
        if (cells.size() != header.size())
            fail("{}: found {} values, expected {} like in the header", line, cells.size(), header.size());
        append_beam(sensor, parse_beam_row(cells, column_indices, line), line);
    }
    if (sensor.beams.empty()) fail("{}: found no beams after the header, expected at least one", where);
    return sensor;
}

}  // namespace relidar
