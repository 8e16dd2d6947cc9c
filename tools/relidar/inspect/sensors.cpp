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

double scan_period_s(const SensorModel& sensor, const RayTable& rays) {
    if (const double period_s = relidar::scan_period_s(sensor.pattern); period_s > 0.0) return period_s;
    const auto [first, last] = std::ranges::minmax(rays.time_offset_s);
    return double(last) - double(first);
}

void print_sensors() {
    std::vector<std::vector<std::string>> rows{
        {"name", "rays", "azimuth", "elevation", "scan time", "range", "divergence", "source of the values"}};
    for (const std::string& name : list_sensors()) {
        const SensorModel sensor = *find_built_in(name);
        const RayTable rays = make_rays(sensor);
        const SensorFieldOfView fov = angular_extent(rays);
        // A gap of less than 10 degrees is a step between columns.
        const bool round = fov.left_deg - fov.right_deg > 350.0;
        rows.push_back(
            {name,
             rays.rows > 1 ? fmt::format("{} x {}", rays.rows, rays.columns) : fmt::format("{}", rays.size()),
             round ? "full turn" : fmt::format("{:+.1f} to {:+.1f}", fov.left_deg, fov.right_deg),
             fmt::format("{:+.2f} to {:+.2f}", fov.top_deg, fov.bottom_deg),
             fmt::format("{:.0f} ms", 1e3 * scan_period_s(sensor, rays)),
             fmt::format("{:g} to {:g} m", sensor.limits.min_m, sensor.limits.max_m),
             rays.divergence_rad > 0.0f ? fmt::format("{:.1f} mrad", 1e3 * double(rays.divergence_rad)) : "-",
             sensor.about});
    }
    print(format_table(rows) +
          "\nAngles are in degrees; left and up are positive. Divergence is the full angle of a beam; - if "
          "unknown.\n");
}

/// Draws each ray of a sensor as a dot whose colour shows its firing time. Azimuth
/// increases to the right and elevation upwards.
Image draw_ray_pattern(const RayTable& rays) {
    constexpr double kViewSector_rad = 20.0 * kPi / 180.0, kViewMargin_rad = 0.5 * kPi / 180.0;
    constexpr int kPictureWidth_px = 1200, kDotSize_px = 2;
    std::vector<glm::dvec2> angle;  // Azimuth and elevation of each ray.
    for (const glm::vec3& d : rays.direction)
        angle.emplace_back(std::atan2(double(d.y), double(d.x)),
                           std::asin(std::clamp(double(d.z), -1.0, 1.0)));
    glm::dvec2 low = angle.front(), high = angle.front();
    for (const glm::dvec2& a : angle) {
        low = glm::min(low, a);
        high = glm::max(high, a);
    }
    // A sensor that covers a full turn would be too wide, so shows only the 40 degrees
    // ahead.
    if (high.x - low.x > 1.9 * kPi) {
        low.x = -kViewSector_rad;
        high.x = kViewSector_rad;
    }
    low -= kViewMargin_rad;
    high += kViewMargin_rad;
    const double pixels_per_rad = kPictureWidth_px / (high.x - low.x);
    const int rows = std::clamp(static_cast<int>((high.y - low.y) * pixels_per_rad), 1, 8 * kPictureWidth_px);
    std::vector<float> seconds(std::size_t(rows) * kPictureWidth_px, std::numeric_limits<float>::quiet_NaN());
    for (std::size_t i = 0; i < angle.size(); ++i) {
        const int row = static_cast<int>((high.y - angle[i].y) * pixels_per_rad),
                  column = static_cast<int>((high.x - angle[i].x) * pixels_per_rad);
        for (int y = std::max(row, 0); y < std::min(row + kDotSize_px, rows); ++y)
            for (int x = std::max(column, 0); x < std::min(column + kDotSize_px, kPictureWidth_px); ++x)
                seconds[std::size_t(y) * kPictureWidth_px + std::size_t(x)] = rays.time_offset_s[i];
    }
    const auto drawn = [](float value) { return !std::isnan(value); };
    const auto first = std::ranges::find_if(seconds, drawn);
    float earliest = first == seconds.end() ? 0.0f : *first, latest = earliest;
    for (const float value : seconds)
        if (drawn(value)) {
            earliest = std::min(earliest, value);
            latest = std::max(latest, value);
        }
    return apply_colour_map(seconds, rows, kPictureWidth_px, earliest,
                            std::max(latest, std::nextafter(earliest, 1e30f)), "turbo");
}

void print_sensor(const SensorsOptions& options) {
    const SensorModel sensor = find_sensor(options.sensor);
    const RayTable rays = make_rays(sensor, options.time_s);
    const SensorFieldOfView fov = angular_extent(rays);
    const double max_divergence_rad = rays.max_divergence_rad();
    const double min_divergence_rad = rays.ray_divergence_rad.empty()
                                          ? max_divergence_rad
                                          : double(std::ranges::min(rays.ray_divergence_rad));
    const std::string divergence =
        min_divergence_rad < max_divergence_rad
            ? fmt::format("{:.3g} to {:.3g} mrad", 1e3 * min_divergence_rad, 1e3 * max_divergence_rad)
            : fmt::format("{:.3g} mrad", 1e3 * min_divergence_rad);
    print(fmt::format(
        "{}{}{}\nrays        {} ({} rows of {})\nazimuth     {:+.2f} to {:+.2f} degrees, left positive\n"
        "elevation   {:+.2f} to {:+.2f} degrees\nscan time   {:.4g} s\nrange       {:g} to {:g} "
        "m\ndivergence  {}\n",
        sensor.name, sensor.about.empty() ? "" : ": ", sensor.about, fov.rays, rays.rows, rays.columns,
        fov.left_deg, fov.right_deg, fov.top_deg, fov.bottom_deg, scan_period_s(sensor, rays),
        sensor.limits.min_m, sensor.limits.max_m, divergence));
    if (const auto* spinning = std::get_if<SpinningSensor>(&sensor.pattern)) {
        std::vector<std::vector<std::string>> rows{
            {"beam", "elevation", "azimuth offset", "origin forward", "up", "left"}};
        for (std::size_t b = 0; b < spinning->beams.size(); ++b) {
            const Beam& beam = spinning->beams[b];
            rows.push_back({fmt::format("{}", b), fmt::format("{:+.3f}", beam.elevation_rad * 180.0 / kPi),
                            fmt::format("{:+.3f}", beam.azimuth_offset_rad * 180.0 / kPi),
                            fmt::format("{:.4f} m", beam.origin_offset_m),
                            fmt::format("{:.4f} m", beam.origin_up_m),
                            fmt::format("{:.4f} m", beam.origin_left_m)});
        }
        print("\n" + format_table(rows));
    }
    if (!options.out.empty()) {
        write_png(options.out, draw_ray_pattern(rays), {{"relidar", fmt::format("rays of {}", sensor.name)}});
        print(fmt::format(
            "\npicture     {}: x is the azimuth, y the elevation, the colour is the firing time\n",
            options.out));
    }
}

void run_list_sensors(const SensorsOptions& options) {
    if (!options.out.empty() && options.sensor.empty())
        throw UsageError("--out needs a sensor to draw: `relidar list sensors SENSOR --out FILE.png`");
    if (!(std::abs(options.time_s) <= 1e10))
        fail<UsageError>("--time: found {}; expected a time in seconds", options.time_s);
    options.sensor.empty() ? print_sensors() : print_sensor(options);
}

}  // namespace

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
    command->callback([&call, options] { call.run = [options] { run_list_sensors(*options); }; });
}

}  // namespace relidar::cli
