// SPDX-License-Identifier: Apache-2.0
// Sensors by name. The built-in ones are nominal: evenly spaced beams over the field of view that the maker's data sheet
// states; a unit's own calibration comes as a CSV beam table (beam_table.cpp).
#include <relidar/sensor.hpp>

#include <fmt/format.h>

#include <relidar/error.hpp>
#include <relidar/math.hpp>
#include "core/files.hpp"
#include "sensor/beam_table.hpp"

namespace relidar {
namespace {

struct Nominal {
    const char* name;
    int beams;
    double top_deg, bottom_deg;
    int columns;
    double max_range_m, divergence_rad;
};

// Data-sheet facts: vertical field of view, points a sweep at 10 Hz, range, full beam divergence.
constexpr Nominal kNominal[] = {
    {"VLP-16", 16, 15.0, -15.0, 1800, 100.0, 3.0e-3},
    {"OS1-64", 64, 16.6, -16.6, 1024, 120.0, 0.0},
    {"OS1-128", 128, 22.5, -22.5, 1024, 120.0, 0.0},
    {"waymo-top", 64, 2.4, -17.6, 2650, 75.0, 0.0},
};

void add_beams(SpinningSensor& sensor, int n, double top_deg, double bottom_deg) {
    for (int i = 0; i < n; ++i) {
        sensor.beams.push_back({.elevation_rad = (top_deg + (bottom_deg - top_deg) * i / (n - 1)) * kPi / 180.0});
    }
}

SpinningSensor spinning(const std::string& name, int columns, double max_range_m, double divergence_rad) {
    SpinningSensor sensor;
    sensor.name = name;
    sensor.columns = columns;
    sensor.first_azimuth_rad = kPi - kPi / columns;
    sensor.max_range_m = max_range_m;
    sensor.divergence_rad = divergence_rad;
    return sensor;
}

/// The HDL-64E of the data sheet: 32 beams a third of a degree apart from +2, then 32 half a degree apart to -24.33.
SpinningSensor hdl64e() {
    SpinningSensor sensor = spinning("HDL-64E", 2083, 120.0, 2.0e-3);
    add_beams(sensor, 32, 2.0, 2.0 - 31.0 / 3.0);
    add_beams(sensor, 32, -24.33 + 31.0 * 0.5, -24.33);
    return sensor;
}

/// The rays of the KITTI-360 grid as a spinning sensor.
SpinningSensor kitti360() {
    const RangeGrid grid = kitti360_grid();
    SpinningSensor sensor = spinning(grid.name, grid.columns, grid.max_range_m, 0.0);
    sensor.first_azimuth_rad = kPi;
    for (int row = 0; row < grid.rows; ++row) {
        sensor.beams.push_back({.elevation_rad = grid.fov_up_rad - row * grid.fov_rad / grid.rows});
    }
    return sensor;
}

}  // namespace

std::vector<std::string> sensor_names() {
    std::vector<std::string> names{"kitti360", "HDL-64E"};
    for (const Nominal& n : kNominal) names.emplace_back(n.name);
    return names;
}

SpinningSensor find_sensor(const std::string& name_or_file, const std::vector<std::string>& also_known) {
    const std::string name = known_name(name_or_file, sensor_names()).value_or(name_or_file);
    if (name == "kitti360") return kitti360();
    if (name == "HDL-64E") return hdl64e();
    for (const Nominal& n : kNominal) {
        if (name != n.name) continue;
        SpinningSensor sensor = spinning(n.name, n.columns, n.max_range_m, n.divergence_rad);
        add_beams(sensor, n.beams, n.top_deg, n.bottom_deg);
        return sensor;
    }
    const BeamTableName table = parse_beam_table_name(name_or_file);
    if (table.path.extension() == ".csv" || path_exists(table.path)) return read_beam_table(table);
    std::vector<std::string> known = also_known;
    for (const std::string& sensor : sensor_names()) known.push_back(sensor);
    throw UsageError(
        fmt::format("sensor '{}': unknown name, did you mean '{}'? (known: {}; the path of a CSV beam table "
                    "works too, as beams.csv:1024x10)",
                    name_or_file, nearest_name(name_or_file, known), fmt::join(known, ", ")));
}

}  // namespace relidar
