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
#include "base/files.hpp"
#include "log/sensor_files/ray_arrays.hpp"

namespace relidar::sensor_files {
namespace {

enum Field {
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
const std::vector<std::string> kNames{"azimuth_deg", "elevation_deg", "origin_x_m", "origin_y_m",
                                      "origin_z_m",  "time_s",        "channel",    "divergence_mrad",
                                      "min_range_m", "max_range_m"};
// These columns describe the sensor and not a single ray, so every line must contain the
// same value.
constexpr std::array<Field, 2> kOfSensor{kMinRange, kMaxRange};

using Values = std::array<double, kFieldCount>;

/// Returns the values of a CSV line. Missing range limits get the default values of
/// RayColumns.
Values parse_line(const std::string& line, const std::vector<int>& columns, std::size_t n_cells,
                  const std::string& location) {
    const std::vector<std::string_view> cells = split_csv_cells(line);
    if (cells.size() != n_cells)
        throw DataError(fmt::format("{}: found {} values, expected {} like in the header", location,
                                    cells.size(), n_cells));
    Values value{};
    value[kMaxRange] = RayColumns{}.limits.max_m;
    for (std::size_t f = 0; f < kFieldCount; ++f) {
        if (columns[f] < 0) continue;
        const std::string_view cell = cells[static_cast<std::size_t>(columns[f])];
        const auto number = parse_number(cell);
        if (!number || !std::isfinite(*number))
            throw DataError(
                fmt::format("{}: {} is '{}', expected a number", location, kNames[f], make_excerpt(cell)));
        value[f] = *number;
    }
    return value;
}

void add_ray(RayColumns& rays, const Values& values) {
    const double azimuth = values[kAzimuth] * kPi / 180.0, elevation = values[kElevation] * kPi / 180.0,
                 c = std::cos(elevation);
    rays.direction.insert(rays.direction.end(),
                          {c * std::cos(azimuth), c * std::sin(azimuth), std::sin(elevation)});
    rays.origin.insert(rays.origin.end(), {values[kOriginX], values[kOriginY], values[kOriginZ]});
    rays.time_s.push_back(values[kTime]);
    rays.channel.push_back(values[kChannel]);
    rays.divergence_rad.push_back(values[kDivergence] * 1e-3);
}

}  // namespace

SensorModel parse_ray_csv(const std::string& text, const std::string& name, const std::string& location) {
    const std::vector<std::string> lines = split_lines(text);
    const std::vector<std::string_view> header =
        lines.empty() ? std::vector<std::string_view>{} : split_csv_cells(lines[0]);
    const std::vector<int> at = find_columns(header, kNames, location + " line 1");
    if (at[kAzimuth] < 0 || at[kElevation] < 0)
        throw DataError(fmt::format(
            "{} line 1: the column azimuth_deg or elevation_deg is missing, expected both in a ray "
            "table",
            location));
    RayColumns rays;
    Values first{};
    for (std::size_t l = 1; l < lines.size(); ++l) {
        if (trim_spaces(lines[l]).empty()) continue;
        const std::string line = fmt::format("{} line {}", location, l + 1);
        const Values v = parse_line(lines[l], at, header.size(), line);
        if (rays.time_s.empty()) first = v;
        for (const Field f : kOfSensor) {
            if (v[f] != first[f])
                throw DataError(fmt::format(
                    "{}: {} is {}, expected {} like in the first line, because all rays have the same value",
                    line, kNames[f], v[f], first[f]));
        }
        add_ray(rays, v);
    }
    rays.columns = static_cast<int>(std::min(rays.time_s.size(), kMaxRays + 1));
    rays.limits = {first[kMinRange], first[kMaxRange]};
    return make_ray_sensor(rays, name, location);
}

}  // namespace relidar::sensor_files
