// SPDX-License-Identifier: Apache-2.0
// Reads, writes and generates sensors of the kind "window". In such a sensor, mirrors
// scan a rectangular field of view.
#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/fail.hpp"
#include "log/sensor/pattern_kinds.hpp"

namespace relidar {

using namespace sensor;
namespace {

/// Returns one of `count` evenly spaced values; the mean of both ends if it is the only
/// one.
double spaced_value(double first_value, double last_value, int index, int count) {
    return count > 1 ? first_value + (last_value - first_value) * index / (count - 1)
                     : 0.5 * (first_value + last_value);
}

}  // namespace

/// Returns the rays of one scan, evenly spaced in angle from the top left.
RayTable make_rays(const WindowScanSensor& window) {
    check_ray_count(window.name, double(window.rows) * double(window.columns));
    check_pattern(
        window.name, window.period_s,
        {window.left_rad, window.right_rad, window.top_rad, window.bottom_rad, window.divergence_rad});
    if (window.rows > 65535)
        fail<UsageError>("sensor '{}': found {} rows, expected at most 65535", window.name, window.rows);
    RayTable rays;
    rays.rows = window.rows;
    rays.columns = window.columns;
    rays.divergence_rad = float(window.divergence_rad);
    for (int row = 0; row < window.rows; ++row) {
        const double elevation = spaced_value(window.top_rad, window.bottom_rad, row, window.rows);
        const double horizontal = std::cos(elevation);  // length of the horizontal part of the direction
        for (int column = 0; column < window.columns; ++column) {
            const double azimuth = spaced_value(window.left_rad, window.right_rad, column, window.columns);
            // All rays of a column fire together. Time 0 is the middle of the scan.
            const double time_s = ((column + 0.5) / window.columns - 0.5) * window.period_s;
            add_ray(rays,
                    {horizontal * std::cos(azimuth), horizontal * std::sin(azimuth), std::sin(elevation)},
                    time_s, row);
        }
    }
    return rays;
}

/// Reads a scanning-window sensor from JSON. The four angles are those of the outer rays.
SensorModel sensor::parse_window(const JsonField& field, const std::string& default_name) {
    check_members(field, {"rows", "columns"}, {"left", "right", "top", "bottom"});
    const auto [name, limits, period_s, divergence_rad] = read_common(field, default_name);
    const WindowScanSensor window{.name = name,
                                  .rows = int(field.at("rows").integer_in(1, 65535)),
                                  .columns = int(field.at("columns").integer_in(1, 1'000'000)),
                                  .left_rad = read_angle_rad(field, "left", 180.0),
                                  .right_rad = read_angle_rad(field, "right", 180.0),
                                  .top_rad = read_angle_rad(field, "top", 90.0),
                                  .bottom_rad = read_angle_rad(field, "bottom", 90.0),
                                  .period_s = period_s,
                                  .divergence_rad = divergence_rad};
    if (std::size_t(window.rows) * std::size_t(window.columns) > kMaxRays)
        field.reject(fmt::format("found {} rows x {} columns", window.rows, window.columns),
                     fmt::format("expected at most {} rays", kMaxRays));
    return {.name = name, .limits = limits, .pattern = window};
}

nlohmann::ordered_json sensor::write(const WindowScanSensor& window) {
    return {{"rows", window.rows},         {"columns", window.columns},
            {"left_rad", window.left_rad}, {"right_rad", window.right_rad},
            {"top_rad", window.top_rad},   {"bottom_rad", window.bottom_rad},
            {"period_s", window.period_s}, {"divergence_rad", window.divergence_rad}};
}

ScanPatternSummary sensor::describe(const WindowScanSensor& window) {
    return {.n_rays = std::size_t(window.rows) * std::size_t(window.columns),
            .period_s = window.period_s,
            .sweep = AzimuthSweep{window.left_rad, window.right_rad, window.columns}};
}

}  // namespace relidar
