// SPDX-License-Identifier: Apache-2.0
// Provides the built-in sensors by name. The beams have three sources: the tables in
// src/log/sensor/tables, the published calibration of one unit, or even spacing over the
// field of view in the data sheet. Columns, ranges and beam divergence are data-sheet
// values at 10 Hz. A divergence of 0 means that it is not published.
#include <relidar/log/sensor.hpp>

#include <algorithm>
#include <array>
#include <span>
#include <string_view>
#include <utility>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>
#include <relidar/log/sensor_pattern.hpp>

#include "base/assert.hpp"
#include "base/csv.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"
#include "log/sensor/beam_geometry.hpp"
#include "log/sensor/pattern_kinds.hpp"

namespace relidar {

std::span<const std::pair<std::string_view, std::string_view>> table_texts();

namespace {

constexpr double kDegree = kPi / 180.0;

/// Evenly spaced beams from `top_deg` to `bottom_deg`.
struct BeamFan {
    int n_beams = 0;
    double top_deg = 0.0, bottom_deg = 0.0;
};

/// Data sheet of a spinning sensor.
struct DataSheet {
    std::string_view name;
    int columns;
    double min_range_m, max_range_m, divergence_rad;
    const char* beam_source = nullptr;  ///< source of the beams; null: the table in `tables`
    std::array<BeamFan, 2> fans = {};   ///< from the highest to the lowest; unused with a table
};

// The upper 32 beams of the HDL-64E start at +2 degrees, with steps of 1/3 degree. The
// lower 32 beams end at -24.33 degrees, with steps of 1/2 degree. Waymo publishes only
// the highest and the lowest elevation of the short-range LiDARs.
constexpr DataSheet kSpinningSensors[] = {
    {"HDL-64E",
     2083,
     0.0,
     120.0,
     2.0e-3,
     "evenly spaced beams as in the data sheet",
     {{{32, 2.0, 2.0 - 31.0 / 3.0}, {32, -24.33 + 31.0 * 0.5, -24.33}}}},
    {"HDL-64E-S2", 2083, 0.9, 120.0, 2.0e-3},
    {"HDL-64E-S3", 2083, 0.9, 120.0, 2.0e-3},
    {"HDL-64E-KITTI", 2083, 0.9, 120.0, 2.0e-3},
    {"HDL-32E", 2170, 1.0, 100.0, 2.8e-3},
    {"VLP-16", 1808, 0.5, 100.0, 3.0e-3},
    {"VLP-32C", 1808, 1.0, 200.0, 3.0e-3},
    {"VLS-128", 1876, 0.5, 245.0, 0.0},
    {"Pandar40P", 1800, 0.3, 200.0, 0.0},
    {"Pandar64", 1800, 0.3, 200.0, 0.0},
    {"Pandar128", 1800, 0.3, 200.0, 0.0},
    {"OT128", 1800, 0.3, 200.0, 0.0},
    {"QT64", 600, 0.1, 60.0, 0.0},
    {"QT128", 900, 0.05, 50.0, 0.0},
    {"XT16", 2000, 0.05, 120.0, 0.0},
    {"XT32", 2000, 0.05, 120.0, 0.0},
    {"XT32M", 2000, 0.5, 300.0, 0.0},
    {"RS-LiDAR-16", 1800, 0.4, 150.0, 0.0},
    {"OS0-32", 1024, 0.3, 50.0, 0.0},
    {"OS0-128", 1024, 0.3, 50.0, 0.0},
    {"OS1-64", 1024, 0.8, 120.0, 2.3e-3},
    {"OS1-128", 1024, 0.8, 120.0, 3.1e-3},
    {"OS2-128", 1024, 1.0, 240.0, 0.0},
    {"waymo-top", 2650, 0.0, 75.0, 0.0},
    {"waymo-side",
     600,
     0.0,
     20.0,
     0.0,
     "short-range LiDARs of the Waymo Open Dataset: 200 evenly spaced beams from +30 to -90 degrees",
     {{{200, 30.0 - 0.5 * (120.0 / 200.0), -90.0 + 0.5 * (120.0 / 200.0)}}}},
};

SensorModel make_model(SpinningSensor sensor, const std::string& text) {
    return {sensor.name, text, sensor.range_limits(), std::move(sensor)};
}

/// Returns a sensor whose rays are the pixels of KITTI-360 range images in publications.
/// @param columns  0: as in the publications
SensorModel make_kitti360(int columns, double rate_hz) {
    RangeImageGrid grid = kitti360_grid();
    if (columns > 0) grid.columns = columns;
    SpinningSensor sensor = make_grid_sensor(grid);
    sensor.period_s = 1.0 / rate_hz;
    return make_model(std::move(sensor), "image size of published results on KITTI-360, 66 x 1030");
}

/// Returns the CSV text of a table in src/log/sensor/tables. The first line is the
/// source.
std::string find_beam_table(const std::string& name) {
    const auto tables = table_texts();
    const auto table =
        std::ranges::find(tables, name + ".csv", [](const auto& t) { return std::string(t.first); });
    RELIDAR_ASSERT_EQ(table != tables.end(), true);
    return std::string(table->second);
}

/// Returns the source of a beam table from its first line, "# SOURCE".
std::string read_table_source(const std::string& table) { return table.substr(2, table.find('\n') - 2); }

std::vector<Beam> spread_beams(const std::array<BeamFan, 2>& fans) {
    std::vector<Beam> beams;
    for (const auto& [n_beams, top_deg, bottom_deg] : fans)
        for (int beam = 0; beam < n_beams; ++beam) {
            const double elevation_deg = top_deg + (bottom_deg - top_deg) * beam / (n_beams - 1);
            beams.push_back({.elevation_rad = elevation_deg * kDegree});
        }
    return beams;
}

/// Returns a spinning sensor from its data sheet.
/// @param columns  0: the default
SensorModel make_spinning(const DataSheet& sheet, int columns, double rate_hz) {
    if (columns == 0) columns = sheet.columns;
    const std::string name(sheet.name);
    const bool is_ouster = name.starts_with("OS");
    const bool has_table = sheet.beam_source == nullptr;
    const std::string table = has_table ? find_beam_table(name) : "";
    SpinningSensor sensor{
        .name = name,
        .beams = has_table ? parse_beams(table, name, columns, rate_hz).beams : spread_beams(sheet.fans),
        .columns = columns,
        .period_s = 1.0 / rate_hz,
        // Half a column from the rear; the first column of an Ouster is exactly backward.
        .first_azimuth_rad = is_ouster ? kPi : kPi - kPi / columns,
        .min_range_m = sheet.min_range_m,
        .max_range_m = sheet.max_range_m,
        .divergence_rad = sheet.divergence_rad};
    return make_model(std::move(sensor), has_table ? read_table_source(table) : sheet.beam_source);
}

/// Returns the AT128 as a table of rays. Mirrors scan 120 degrees from left to right in
/// 0.1 s. Azimuth offsets of beams are relative to the mirrors.
SensorModel make_at128() {
    constexpr int kColumns = 1200;
    constexpr double kPeriod_s = 0.1, kColumnStep_deg = 0.1;
    const std::string table = find_beam_table("AT128");
    const std::vector<Beam> beams = parse_beams(table, "AT128", kColumns, 1.0 / kPeriod_s).beams;
    RayTable rays;
    rays.rows = int(beams.size());
    rays.columns = kColumns;
    for (std::size_t row = 0; row < beams.size(); ++row)
        for (int column = 0; column < kColumns; ++column) {
            const double columns_to_middle = 0.5 * (kColumns - 1) - column;  // positive on the left
            const double azimuth_rad = columns_to_middle * kColumnStep_deg * kDegree;
            sensor::add_ray(rays, aim_beam(beams[row], azimuth_rad).direction,
                            -columns_to_middle / kColumns * kPeriod_s, int(row));
        }
    return {"AT128", read_table_source(table), {0.5, 200.0}, std::move(rays)};
}

/// Returns a scanning-window sensor with the data-sheet values of the AT128.
SensorModel make_window_128() {
    return {"window-128",
            "hybrid solid-state LiDAR similar to the AT128: mirrors scan 120 x 25.4 degrees, 1200 columns of "
            "128 rows",
            {0.5, 200.0},
            WindowScanSensor{"window-128", 128, 1200, 59.95 * kDegree, -59.95 * kDegree, 12.9 * kDegree,
                             -12.5 * kDegree}};
}

/// Returns a rosette sensor with the data-sheet values of the Mid-40. The rotation rates
/// of the prisms were measured on a Mid-40.
SensorModel make_rosette() {
    return {"rosette",
            "non-repetitive LiDAR similar to the Mid-40: two prisms, a cone of 38.4 degrees, 100 000 rays "
            "per second",
            {1.0, 260.0},
            RosetteSensor{"rosette", 9.6 * kDegree, 7294.0 / 60.0, -4664.0 / 60.0, 10'000}};
}

}  // namespace

std::vector<BeamFiring> read_firings(const std::string& sensor_name) {
    const std::vector<std::string> lines = split_lines(find_beam_table(sensor_name));
    // Line 0 has the source, line 1 the names of the columns, each further line a beam.
    const std::vector<std::string_view> header = split_csv_cells(lines[1]);
    std::vector<BeamFiring> firings;
    for (std::size_t l = 2; l < lines.size(); ++l) {
        const std::vector<std::string_view> cells = split_csv_cells(lines[l]);
        const auto value_of = [&](std::string_view column_name) {
            const auto column = std::size_t(std::ranges::find(header, column_name) - header.begin());
            // 0 if the table has no such column
            return column < header.size() ? parse_number(cells.at(column)).value_or(0.0) : 0.0;
        };
        firings.push_back({int(value_of("channel")), value_of("firing_offset_us")});
    }
    return firings;
}

std::optional<double> nominal_max_range_m(const std::string& sensor_name) {
    const auto sensor = find_built_in(sensor_name.substr(0, sensor_name.find(" fitted to ")));
    return sensor ? std::optional(sensor->limits.max_m) : std::nullopt;
}

std::vector<std::string> list_sensors() {
    std::vector<std::string> names{"kitti360"};
    for (const DataSheet& sensor : kSpinningSensors) names.emplace_back(sensor.name);
    for (const char* name : {"AT128", "window-128", "rosette"}) names.emplace_back(name);
    return names;
}

std::optional<SensorModel> find_built_in(const std::string& name, int columns, double rate_hz) {
    const auto sensor_name = find_name(name, list_sensors());
    if (!sensor_name) return {};
    constexpr double kDefaultRate_hz = 10.0;
    const double rate = rate_hz > 0.0 ? rate_hz : kDefaultRate_hz;
    if (*sensor_name == "kitti360") return make_kitti360(columns, rate);
    const auto* spinning = std::ranges::find(kSpinningSensors, *sensor_name, &DataSheet::name);
    if (spinning != std::end(kSpinningSensors)) return make_spinning(*spinning, columns, rate);
    if (columns > 0 || rate_hz > 0.0)
        fail<UsageError>(
            "sensor '{}': found columns and a rate, but this sensor does not spin; use only its name", name);
    if (*sensor_name == "AT128") return make_at128();
    return *sensor_name == "window-128" ? make_window_128() : make_rosette();
}

}  // namespace relidar
