// SPDX-License-Identifier: Apache-2.0
// The command `relidar list sensors` prints the built-in sensors and where their data
// come from. It can also draw the ray pattern of a sensor.
#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <relidar/base/images.hpp>
#include <relidar/log/sensor_files.hpp>
#include "base/fail.hpp"
#include "command.hpp"
#include "console.hpp"
#include "options.hpp"

namespace relidar::cli {
namespace {

struct SensorsOptions {
    std::string sensor;
    std::string out;
    double time_s = 0.0;
};

struct SensorFieldOfView {
    std::size_t rays = 0;
    double left_deg = 0.0, right_deg = 0.0, top_deg = 0.0, bottom_deg = 0.0;
};

/// Returns the smallest and largest angles of the rays. Left and up are positive.
SensorFieldOfView angular_extent(const RayTable& rays) {
    // Each maximum starts at the lowest possible angle, each minimum at the highest.
    SensorFieldOfView fov{rays.size(), -180.0, 180.0, -90.0, 90.0};
    for (const glm::vec3& d : rays.direction) {
        const double azimuth = std::atan2(double(d.y), double(d.x)) * 180.0 / kPi,
                     elevation = std::asin(std::clamp(double(d.z), -1.0, 1.0)) * 180.0 / kPi;
        fov.left_deg = std::max(fov.left_deg, azimuth);
        fov.right_deg = std::min(fov.right_deg, azimuth);
        fov.top_deg = std::max(fov.top_deg, elevation);
        fov.bottom_deg = std::min(fov.bottom_deg, elevation);
    }
    return fov;
}

/// Returns the period of a pattern, or the time from first to last ray if it has none.
double scan_period_s(const SensorModel& sensor, const RayTable& rays) {
    if (const double period_s = relidar::scan_period_s(sensor.pattern); period_s > 0.0) return period_s;
    const auto [first, last] = std::ranges::minmax(rays.time_offset_s);
    return double(last) - double(first);
}

/// Prints a table of all built-in sensors.
void print_sensors() {
    TableRows rows{
        {"name", "rays", "azimuth", "elevation", "scan time", "range", "divergence", "source of the values"}};
    for (const std::string& name : list_sensors()) {
        const SensorModel sensor = *find_built_in(name);
        const RayTable rays = make_rays(sensor);
        const SensorFieldOfView fov = angular_extent(rays);
        const std::string size =
            rays.rows > 1 ? fmt::format("{} x {}", rays.rows, rays.columns) : fmt::format("{}", rays.size());
        // A gap of less than 10 degrees is a step between columns.
        const bool is_full_turn = fov.left_deg - fov.right_deg > 350.0;
        const bool has_divergence = rays.divergence_rad > 0.0f;
        rows.push_back(
            {name, size,
             is_full_turn ? "full turn" : fmt::format("{:+.1f} to {:+.1f}", fov.left_deg, fov.right_deg),
             fmt::format("{:+.2f} to {:+.2f}", fov.top_deg, fov.bottom_deg),
             fmt::format("{:.0f} ms", 1e3 * scan_period_s(sensor, rays)),
             fmt::format("{:g} to {:g} m", sensor.limits.min_m, sensor.limits.max_m),
             has_divergence ? fmt::format("{:.1f} mrad", 1e3 * double(rays.divergence_rad)) : "-",
             sensor.about});
    }
    print(format_table(rows) +
          "\nAngles are in degrees; left and up are positive. Divergence is the full angle of a beam; - if "
          "unknown.\n");
}

/// Returns azimuth and elevation of each ray in radians.
std::vector<glm::dvec2> ray_angles(const RayTable& rays) {
    std::vector<glm::dvec2> angles;
    for (const glm::vec3& d : rays.direction)
        angles.emplace_back(std::atan2(double(d.y), double(d.x)),
                            std::asin(std::clamp(double(d.z), -1.0, 1.0)));
    return angles;
}

/// Draws each ray of a sensor as a dot whose colour shows its firing time, as the sensor
/// sees it: azimuth increases to the left and elevation upwards.
Image draw_ray_pattern(const RayTable& rays) {
    constexpr double kViewSector_rad = 20.0 * kPi / 180.0, kViewMargin_rad = 0.5 * kPi / 180.0;
    constexpr int kPictureWidth_px = 1200, kDotSize_px = 2;
    const std::vector<glm::dvec2> angles = ray_angles(rays);
    glm::dvec2 low = angles.front(), high = angles.front();  // x: azimuth, y: elevation
    for (const glm::dvec2& angle : angles) {
        low = glm::min(low, angle);
        high = glm::max(high, angle);
    }
    // A full turn would be too wide, so shows only the 40 degrees ahead.
    const bool is_full_turn = high.x - low.x > 1.9 * kPi;
    if (is_full_turn) {
        low.x = -kViewSector_rad;
        high.x = kViewSector_rad;
    }
    low -= kViewMargin_rad;
    high += kViewMargin_rad;

    // Stores the firing time of each pixel, or NaN if it shows no ray.
    const double pixels_per_rad = kPictureWidth_px / (high.x - low.x);
    const int rows = std::clamp(static_cast<int>((high.y - low.y) * pixels_per_rad), 1, 8 * kPictureWidth_px);
    std::vector<float> seconds(std::size_t(rows) * kPictureWidth_px, std::numeric_limits<float>::quiet_NaN());
    float earliest_s = std::numeric_limits<float>::infinity(), latest_s = -earliest_s;
    for (std::size_t i = 0; i < angles.size(); ++i) {
        const int top = static_cast<int>((high.y - angles[i].y) * pixels_per_rad),
                  left = static_cast<int>((high.x - angles[i].x) * pixels_per_rad);
        for (int row = std::max(top, 0); row < std::min(top + kDotSize_px, rows); ++row)
            for (int column = std::max(left, 0); column < std::min(left + kDotSize_px, kPictureWidth_px);
                 ++column)
                seconds[std::size_t(row) * kPictureWidth_px + std::size_t(column)] = rays.time_offset_s[i];
    }
    for (const float time_s : seconds) {
        if (std::isnan(time_s)) continue;
        earliest_s = std::min(earliest_s, time_s);
        latest_s = std::max(latest_s, time_s);
    }
    if (earliest_s > latest_s) earliest_s = latest_s = 0.0f;  // No ray is in the picture.
    // The colour map needs a range that is not empty.
    return apply_colour_map(seconds, rows, kPictureWidth_px, earliest_s,
                            std::max(latest_s, std::nextafter(earliest_s, 1e30f)), "turbo");
}

/// Returns the divergence of the beams, or its range if the beams differ.
std::string format_divergence(const RayTable& rays) {
    const double max_mrad = 1e3 * rays.max_divergence_rad();
    const double min_mrad =
        rays.ray_divergence_rad.empty() ? max_mrad : 1e3 * double(std::ranges::min(rays.ray_divergence_rad));
    return min_mrad < max_mrad ? fmt::format("{:.3g} to {:.3g} mrad", min_mrad, max_mrad)
                               : fmt::format("{:.3g} mrad", min_mrad);
}

/// Returns a table with the angles and origins of the beams of a spinning sensor.
std::string beam_table(const SpinningSensor& sensor) {
    TableRows rows{{"beam", "elevation", "azimuth offset", "origin forward", "up", "left"}};
    for (std::size_t i = 0; i < sensor.beams.size(); ++i) {
        const Beam& beam = sensor.beams[i];
        rows.push_back({fmt::format("{}", i), fmt::format("{:+.3f}", beam.elevation_rad * 180.0 / kPi),
                        fmt::format("{:+.3f}", beam.azimuth_offset_rad * 180.0 / kPi),
                        fmt::format("{:.4f} m", beam.origin_offset_m),
                        fmt::format("{:.4f} m", beam.origin_up_m),
                        fmt::format("{:.4f} m", beam.origin_left_m)});
    }
    return format_table(rows);
}

/// Prints the properties of one sensor. With --out, also draws its rays.
void print_sensor(const SensorsOptions& options) {
    const SensorModel sensor = find_sensor(options.sensor);
    const RayTable rays = make_rays(sensor, options.time_s);
    const SensorFieldOfView fov = angular_extent(rays);
    print(fmt::format(
        "{}{}{}\nrays        {} ({} rows of {})\nazimuth     {:+.2f} to {:+.2f} degrees, left positive\n"
        "elevation   {:+.2f} to {:+.2f} degrees\nscan time   {:.4g} s\nrange       {:g} to {:g} "
        "m\ndivergence  {}\n",
        sensor.name, sensor.about.empty() ? "" : ": ", sensor.about, fov.rays, rays.rows, rays.columns,
        fov.left_deg, fov.right_deg, fov.top_deg, fov.bottom_deg, scan_period_s(sensor, rays),
        sensor.limits.min_m, sensor.limits.max_m, format_divergence(rays)));
    if (const auto* spinning = std::get_if<SpinningSensor>(&sensor.pattern))
        print("\n" + beam_table(*spinning));
    if (options.out.empty()) return;
    write_png(options.out, draw_ray_pattern(rays), {{"relidar", fmt::format("rays of {}", sensor.name)}});
    print(fmt::format("\npicture     {}: x is the azimuth, y the elevation, the colour is the firing time\n",
                      options.out));
}

void run_list_sensors(const SensorsOptions& options) {
    if (!options.out.empty() && options.sensor.empty())
        throw UsageError("--out needs a sensor to draw: `relidar list sensors SENSOR --out FILE.png`");
    if (!(std::abs(options.time_s) <= 1e10))
        fail<UsageError>("--time: found {}; expected a time in seconds", options.time_s);
    if (options.sensor.empty()) print_sensors();
    else print_sensor(options);
}

}  // namespace

/// Adds the command `relidar list sensors` and its options to the parser.
void add_list_sensors(CLI::App& list_command, ParsedCommand& call) {
    CLI::App* command = list_command.add_subcommand(
        "sensors", "list the sensors that can be simulated, or show the properties of one sensor");
    const auto options = std::make_shared<SensorsOptions>();
    command->add_option("SENSOR", options->sensor, "name or file of a sensor (default: list all names)");
    add_option(*command, "--out FILE.png", options->out,
               "PNG file for a picture of the rays: x is the azimuth, y the elevation, the colour is the "
               "firing time");
    add_option(*command, "--time SECONDS", options->time_s,
               "time of the scan, for a sensor whose rays differ between scans (default: 0)");
    command->footer(
        sensor_file_help() +
        "\n\nExamples:\n  relidar list sensors\n  relidar list sensors OS1-128 --out pattern.png\n"
        "  relidar list sensors metadata.json\n"
        "  relidar render run --out scans --sensor OS1-128:2048x10");
    run_after_parsing(*command, call, options, run_list_sensors);
}

}  // namespace relidar::cli
