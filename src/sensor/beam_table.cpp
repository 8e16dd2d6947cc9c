// SPDX-License-Identifier: Apache-2.0
// CSV beam tables (kBeamTableHelp): header line, then one line a beam. A column that is not known is an error: a misspelt one would be 0.
#include "sensor/beam_table.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include <fmt/format.h>

#include <relidar/error.hpp>
#include <relidar/math.hpp>
#include "core/files.hpp"

namespace relidar {
namespace {

enum Field { kElevation, kAzimuthOffset, kOriginOffset, kOriginUp, kOriginLeft, kMinRange, kMaxRange, kChannel, kFieldCount };

struct FieldRule {
    const char* name;
    double low, high, missing;   ///< values allowed, and the one where the table has no such column
};
constexpr double kFarthest_m = 10'000.0;
// Not constexpr: clang 14 makes no std::string at compile time, and a SpinningSensor has one.
const std::array<FieldRule, kFieldCount> kFields{{{"elevation_deg", -90.0, 90.0, 0.0},
                                                  {"azimuth_offset_deg", -180.0, 180.0, 0.0},
                                                  {"origin_offset_m", -10.0, 10.0, 0.0},
                                                  {"origin_up_m", -10.0, 10.0, 0.0},
                                                  {"origin_left_m", -10.0, 10.0, 0.0},
                                                  {"min_range_m", 0.0, kFarthest_m, SpinningSensor{}.min_range_m},
                                                  {"max_range_m", 0.0, kFarthest_m, SpinningSensor{}.max_range_m},
                                                  {"channel", 0.0, 65535.0, 0.0}}};

using Columns = std::array<int, kFieldCount>;     ///< of each field, -1 where it is missing
using Values = std::array<double, kFieldCount>;

constexpr double kMaxColumns = 1'000'000, kMaxRate_hz = 10'000;

std::vector<std::string_view> split_commas(std::string_view line) {
    std::vector<std::string_view> cells;
    for (std::size_t begin = 0; begin <= line.size();) {
        const std::size_t end = std::min(line.find(',', begin), line.size());
        cells.push_back(trimmed(line.substr(begin, end - begin)));
        begin = end + 1;
    }
    return cells;
}

/// Where the header has each field. @throws DataError for a column that is not known, or there twice
Columns find_fields(const std::vector<std::string_view>& header, const std::string& path) {
    std::vector<std::string> known;
    for (const FieldRule& field : kFields) known.emplace_back(field.name);
    Columns at;
    at.fill(-1);
    for (std::size_t c = 0; c < header.size(); ++c) {
        const auto f = static_cast<std::size_t>(std::find(known.begin(), known.end(), header[c]) - known.begin());
        if (f == known.size()) {
            throw DataError(fmt::format("{} line 1: column '{}' is not known, did you mean '{}'? (known: {})", path, header[c],
                                        nearest_name(header[c], known), fmt::join(known, ", ")));
        }
        if (at[f] >= 0) throw DataError(fmt::format("{} line 1: column '{}' is there twice, expected once", path, header[c]));
        at[f] = static_cast<int>(c);
    }
    return at;
}

Values parse_line(const std::vector<std::string_view>& cells, const Columns& at, const std::string& where) {
    Values value{};
    for (std::size_t f = 0; f < kFields.size(); ++f) {
        const FieldRule& rule = kFields[f];
        value[f] = rule.missing;
        if (at[f] < 0) continue;
        const std::string_view cell = cells[static_cast<std::size_t>(at[f])];
        const auto number = parse_number(cell);
        if (!number || !(*number >= rule.low && *number <= rule.high)) {
            throw DataError(fmt::format("{}: {} is '{}', expected a number in [{}, {}]", where, rule.name, cell, rule.low, rule.high));
        }
        value[f] = *number;
    }
    return value;
}

/// Adds the beam of a line. @throws DataError where it is above the one before, or the sensor's range limits are others
void add_beam(SpinningSensor& sensor, const Values& v, const std::string& where) {
    const Beam beam{v[kElevation] * kPi / 180.0, v[kAzimuthOffset] * kPi / 180.0, v[kOriginOffset], v[kOriginUp], v[kOriginLeft]};
    if (sensor.beams.empty()) {
        sensor.min_range_m = v[kMinRange];
        sensor.max_range_m = v[kMaxRange];
    }
    if (v[kMinRange] != sensor.min_range_m || v[kMaxRange] != sensor.max_range_m) {
        throw DataError(
            fmt::format("{}: found ranges of {} to {} m, expected {} to {} m as in the first line: limits are those of the sensor", where,
                        v[kMinRange], v[kMaxRange], sensor.min_range_m, sensor.max_range_m));
    }
    if (!(v[kMinRange] < v[kMaxRange])) {
        throw DataError(
            fmt::format("{}: found ranges of {} to {} m, expected min_range_m below max_range_m", where, v[kMinRange], v[kMaxRange]));
    }
    if (!sensor.beams.empty() && beam.elevation_rad > sensor.beams.back().elevation_rad) {
        throw DataError(fmt::format("{}: elevation_deg rises, expected rows from the highest beam down", where));
    }
    sensor.beams.push_back(beam);
}

}  // namespace

BeamTableName parse_beam_table_name(const std::string& name) {
    BeamTableName table;
    table.path = name;
    const std::size_t colon = name.rfind(':');
    if (colon == std::string::npos || colon == 0) return table;
    const std::string_view suffix = std::string_view(name).substr(colon + 1);
    const std::size_t x = std::min(suffix.find('x'), suffix.size());
    const auto columns = parse_number(suffix.substr(0, x));
    const auto rate_hz = x < suffix.size() ? parse_number(suffix.substr(x + 1)) : std::optional<double>(table.rate_hz);
    if (!columns || !rate_hz) return table;  // a colon of the path itself
    if (!(*columns >= 1.0 && *columns <= kMaxColumns) || *columns != std::floor(*columns) || !(*rate_hz > 0.0 && *rate_hz <= kMaxRate_hz)) {
        throw UsageError(
            fmt::format("sensor '{}': {} columns at {} Hz, expected a whole number from 1 to {} and a rate above 0, at most {}", name,
                        *columns, *rate_hz, kMaxColumns, kMaxRate_hz));
    }
    table.path = name.substr(0, colon);
    table.columns = static_cast<int>(*columns);
    table.rate_hz = *rate_hz;
    return table;
}

SpinningSensor read_beam_table(const BeamTableName& name) {
    const std::string path = name.path.string();
    const std::vector<std::string> lines = split_lines(read_file(name.path));
    const std::vector<std::string_view> header = lines.empty() ? std::vector<std::string_view>{} : split_commas(lines[0]);
    const Columns at = find_fields(header, path);
    if (at[kElevation] < 0)
        throw DataError(fmt::format("{}: no column 'elevation_deg' in the first line, expected a CSV beam table", path));

    SpinningSensor sensor;
    sensor.name = name.path.stem().string();
    sensor.columns = name.columns;
    sensor.period_s = 1.0 / name.rate_hz;
    sensor.first_azimuth_rad = kPi - kPi / name.columns;
    for (std::size_t l = 1; l < lines.size(); ++l) {
        if (trimmed(lines[l]).empty()) continue;
        const std::string where = fmt::format("{} line {}", path, l + 1);
        const auto cells = split_commas(lines[l]);
        if (cells.size() != header.size()) {
            throw DataError(fmt::format("{}: {} values, expected {} as in the header", where, cells.size(), header.size()));
        }
        add_beam(sensor, parse_line(cells, at, where), where);
    }
    if (sensor.beams.empty()) throw DataError(fmt::format("{}: no beams after the header, expected at least one", path));
    return sensor;
}

}  // namespace relidar
