// SPDX-License-Identifier: Apache-2.0
// CSV beam tables: header line, then one line a beam. Known columns: elevation_deg (needed), azimuth_offset_deg,
// origin_offset_m, origin_up_m, origin_left_m; others (channel, ...) are left alone.
#include "sensor/beam_table.hpp"

#include <array>
#include <cmath>
#include <optional>

#include <fmt/format.h>

#include <relidar/error.hpp>
#include <relidar/math.hpp>
#include "core/files.hpp"

namespace relidar {
namespace {

constexpr std::array<const char*, 5> kFields{"elevation_deg", "azimuth_offset_deg", "origin_offset_m", "origin_up_m", "origin_left_m"};

std::vector<std::string_view> split_commas(std::string_view line) {
    std::vector<std::string_view> cells;
    for (std::size_t begin = 0; begin <= line.size();) {
        const std::size_t end = std::min(line.find(',', begin), line.size());
        cells.push_back(trimmed(line.substr(begin, end - begin)));
        begin = end + 1;
    }
    return cells;
}

/// Position of each known field in the header, -1 where it is missing.
std::array<int, kFields.size()> find_fields(const std::vector<std::string_view>& header) {
    std::array<int, kFields.size()> at;
    for (std::size_t f = 0; f < kFields.size(); ++f) {
        at[f] = -1;
        for (std::size_t c = 0; c < header.size(); ++c) {
            if (header[c] == kFields[f]) at[f] = static_cast<int>(c);
        }
    }
    return at;
}

Beam parse_beam(const std::vector<std::string_view>& cells, const std::array<int, kFields.size()>& at, const std::string& where) {
    std::array<double, kFields.size()> value{};
    for (std::size_t f = 0; f < kFields.size(); ++f) {
        if (at[f] < 0) continue;
        const std::string_view cell = cells[static_cast<std::size_t>(at[f])];
        const auto number = parse_number(cell);
        const double limit = f == 0 ? 90.0 : f == 1 ? 180.0 : 10.0;
        if (!number || !(std::abs(*number) <= limit)) {
            throw DataError(fmt::format("{}: {} is '{}', expected a number in [-{}, {}]", where, kFields[f], cell, limit, limit));
        }
        value[f] = *number;
    }
    return {value[0] * kPi / 180.0, value[1] * kPi / 180.0, value[2], value[3], value[4]};
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
    if (!(*columns >= 1.0 && *columns <= 1e6) || *columns != std::floor(*columns) || !(*rate_hz > 0.0 && *rate_hz <= 1e4)) {
        throw UsageError(
            fmt::format("sensor '{}': {} columns at {} Hz, expected a whole number and a rate, both above 0", name, *columns, *rate_hz));
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
    const auto at = find_fields(header);
    if (at[0] < 0) throw DataError(fmt::format("{}: no column 'elevation_deg' in the first line, expected a CSV beam table", path));

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
        sensor.beams.push_back(parse_beam(cells, at, where));
        const std::size_t n = sensor.beams.size();
        if (n > 1 && sensor.beams[n - 1].elevation_rad > sensor.beams[n - 2].elevation_rad) {
            throw DataError(fmt::format("{}: elevation_deg rises, expected rows from the highest beam down", where));
        }
    }
    if (sensor.beams.empty()) throw DataError(fmt::format("{}: no beams after the header, expected at least one", path));
    return sensor;
}

}  // namespace relidar
