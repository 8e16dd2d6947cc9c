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

enum BeamTableField {
    kElevation,
    kAzimuthOffset,
    kOriginOffset,
    kOriginUp,
    kOriginLeft,
    kFiring,
    kMinRange,
    kMaxRange,
    kChannel,
    kFieldCount
};

struct FieldRule {
    const char* name;
    double low, high, missing;  ///< allowed values, and the value that is used if the column is missing
};
constexpr double kFarthestLimit_m = 10'000.0;
// clang 14 cannot create the std::string in SpinningSensor at compile time.
const std::array<FieldRule, kFieldCount> kFieldRules{
    {{"elevation_deg", -90.0, 90.0, 0.0},
     {"azimuth_offset_deg", -180.0, 180.0, 0.0},
     {"origin_offset_m", -10.0, 10.0, 0.0},
     {"origin_up_m", -10.0, 10.0, 0.0},
     {"origin_left_m", -10.0, 10.0, 0.0},
     {"firing_offset_us", 0.0, 1e6, 0.0},
     {"min_range_m", 0.0, kFarthestLimit_m, SpinningSensor{}.min_range_m},
     {"max_range_m", 0.0, kFarthestLimit_m, RangeLimits{}.max_m},
     {"channel", 0.0, 65535.0, 0.0}}};

using BeamRow = std::array<double, kFieldCount>;

/// Returns the values of one beam. A missing column has the index -1.
BeamRow parse_beam_row(const std::vector<std::string_view>& cells, const std::vector<int>& column_of_field,
                       const std::string& where) {
    BeamRow value{};
    for (std::size_t f = 0; f < kFieldRules.size(); ++f) {
        const FieldRule& rule = kFieldRules[f];
        value[f] = rule.missing;
        if (column_of_field[f] < 0) continue;
        const std::string_view cell = cells[std::size_t(column_of_field[f])];
        const auto number = parse_number(cell);
        if (!number || !(*number >= rule.low && *number <= rule.high))
            fail("{}: {} is '{}', expected a number in [{}, {}]", where, rule.name, cell, rule.low,
                 rule.high);
        value[f] = *number;
    }
    return value;
}

/// Adds the beam in one line of a beam table to a sensor.
/// @throws DataError if the beam is higher than the previous one, or if its range limits
/// differ from the first line
void append_beam(SpinningSensor& sensor, const BeamRow& row_values, const std::string& where) {
    // The head turns on between the nominal time and the firing. The rotation is
    // negative, because the head turns clockwise.
    const double turned_rad = -2.0 * kPi / sensor.period_s * row_values[kFiring] * 1e-6;
    const Beam beam{row_values[kElevation] * kPi / 180.0,
                    row_values[kAzimuthOffset] * kPi / 180.0 + turned_rad, row_values[kOriginOffset],
                    row_values[kOriginUp], row_values[kOriginLeft]};
    if (sensor.beams.empty()) {
        sensor.min_range_m = row_values[kMinRange];
        sensor.max_range_m = row_values[kMaxRange];
    }
    if (row_values[kMinRange] != sensor.min_range_m || row_values[kMaxRange] != sensor.max_range_m)
        fail(
            "{}: found range limits of {} to {} m, expected {} to {} m like in the first line, because all "
            "beams have the same limits",
            where, row_values[kMinRange], row_values[kMaxRange], sensor.min_range_m, sensor.max_range_m);
    if (!(row_values[kMinRange] < row_values[kMaxRange]))
        fail("{}: found range limits of {} to {} m, expected min_range_m below max_range_m", where,
             row_values[kMinRange], row_values[kMaxRange]);
    if (!sensor.beams.empty() && beam.elevation_rad > sensor.beams.back().elevation_rad)
        fail("{}: elevation_deg increases, expected rows from the highest beam to the lowest", where);
    sensor.beams.push_back(beam);
}

}  // namespace

SpinningSensor parse_beams(const std::string& text, const std::string& where, int n_columns, double rate_hz) {
    const std::vector<std::string> lines = split_lines(text);
    const auto first =
        std::size_t(std::find_if(lines.begin(), lines.end(),
                                 [](const std::string& line) { return !line.starts_with('#'); }) -
                    lines.begin());
    const std::vector<std::string_view> header =
        first == lines.size() ? std::vector<std::string_view>{} : split_csv_cells(lines[first]);
    std::vector<std::string> column_names;
    for (const FieldRule& field : kFieldRules) column_names.emplace_back(field.name);
    const std::vector<int> at =
        find_columns(header, column_names, fmt::format("{} line {}", where, first + 1));
    if (at[kElevation] < 0)
        fail("{}: the first line has no column 'elevation_deg', expected a CSV beam table", where);

    SpinningSensor sensor;
    sensor.columns = n_columns;
    sensor.period_s = 1.0 / rate_hz;
    // Half a column from the rear, so that the columns are symmetric to the front.
    sensor.first_azimuth_rad = kPi - kPi / n_columns;
    for (std::size_t l = first + 1; l < lines.size(); ++l) {
        if (trim(lines[l]).empty() || lines[l].starts_with('#')) continue;
        const std::string line = fmt::format("{} line {}", where, l + 1);
        const auto cells = split_csv_cells(lines[l]);
        if (cells.size() != header.size())
            fail("{}: found {} values, expected {} like in the header", line, cells.size(), header.size());
        append_beam(sensor, parse_beam_row(cells, at, line), line);
    }
    if (sensor.beams.empty()) fail("{}: found no beams after the header, expected at least one", where);
    return sensor;
}

}  // namespace relidar
