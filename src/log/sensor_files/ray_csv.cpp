// SPDX-License-Identifier: Apache-2.0
// Reads ray tables in CSV format: a header line, then one line per ray in firing order.
// An unknown column is an error.
#include <algorithm>
#include <array>
#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>
#include "base/csv.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"
#include "log/sensor_files/ray_arrays.hpp"

namespace relidar::sensor_files {
namespace {

enum RayCsvField {
    kAzimuth,
    kElevation,
    kOriginX,
    kOriginY,
    kOriginZ,
    kTime,
    kChannel,
    kDivergence,
    kMinRange,
    kMaxRange,
    kFieldCount
};
const std::vector<std::string> kColumnNames{"azimuth_deg", "elevation_deg", "origin_x_m", "origin_y_m",
                                            "origin_z_m",  "time_s",        "channel",    "divergence_mrad",
                                            "min_range_m", "max_range_m"};
// limits of the sensor: the same value in every line
constexpr std::array<RayCsvField, 2> kOfSensor{kMinRange, kMaxRange};

using RayCsvRow = std::array<double, kFieldCount>;

/// Values of missing columns are 0, except the maximum range, which has its default.
RayCsvRow parse_ray_line(const std::string& line, const std::vector<int>& column_of_field,
                         std::size_t n_cells, const std::string& where) {
    const std::vector<std::string_view> cells = split_csv_cells(line);
    if (cells.size() != n_cells)
        fail("{}: found {} values, expected {} like in the header", where, cells.size(), n_cells);
    RayCsvRow value{};
    value[kMaxRange] = RayFileArrays{}.limits.max_m;
    for (std::size_t f = 0; f < kFieldCount; ++f) {
        if (column_of_field[f] < 0) continue;
        const std::string_view cell = cells[std::size_t(column_of_field[f])];
        const auto number = parse_number(cell);
        if (!number || !std::isfinite(*number))
            fail("{}: {} is '{}', expected a number", where, kColumnNames[f], quote(cell));
        value[f] = *number;
    }
    return value;
}

/// Converts the angles to a direction (x forward, y left, z up).
void append_ray_row(RayFileArrays& rays, const RayCsvRow& row_values) {
    const double azimuth = row_values[kAzimuth] * kPi / 180.0,
                 elevation = row_values[kElevation] * kPi / 180.0, c = std::cos(elevation);
    rays.direction.insert(rays.direction.end(),
                          {c * std::cos(azimuth), c * std::sin(azimuth), std::sin(elevation)});
    rays.origin.insert(rays.origin.end(), {row_values[kOriginX], row_values[kOriginY], row_values[kOriginZ]});
    rays.time_s.push_back(row_values[kTime]);
    rays.channel.push_back(row_values[kChannel]);
    rays.divergence_rad.push_back(row_values[kDivergence] * 1e-3);
}

}  // namespace

SensorModel parse_ray_csv(const std::string& csv_text, const std::string& name, const std::string& where) {
    const std::vector<std::string> lines = split_lines(csv_text);
    const std::vector<std::string_view> header =
        lines.empty() ? std::vector<std::string_view>{} : split_csv_cells(lines[0]);
    const std::vector<int> at = find_columns(header, kColumnNames, where + " line 1");
    if (at[kAzimuth] < 0 || at[kElevation] < 0)
        fail("{} line 1: the column azimuth_deg or elevation_deg is missing, expected both in a ray table",
             where);
    RayFileArrays rays;
    RayCsvRow first{};
    for (std::size_t l = 1; l < lines.size(); ++l) {
        if (trim(lines[l]).empty()) continue;
        const std::string line = fmt::format("{} line {}", where, l + 1);
        const RayCsvRow v = parse_ray_line(lines[l], at, header.size(), line);
        if (rays.time_s.empty()) first = v;
        for (const RayCsvField f : kOfSensor)
            if (v[f] != first[f])
                fail(
                    "{}: {} is {}, expected {} like in the first line; this column needs one value for all "
                    "rays",
                    line, kColumnNames[f], v[f], first[f]);
        append_ray_row(rays, v);
    }
    // A single row. make_ray_sensor() reports too many rays.
    rays.columns = int(std::min(rays.time_s.size(), kMaxRays + 1));
    rays.limits = {first[kMinRange], first[kMaxRange]};
    return make_ray_sensor(rays, name, where);
}

}  // namespace relidar::sensor_files
