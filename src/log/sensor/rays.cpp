// SPDX-License-Identifier: Apache-2.0
// Generates the ray tables of spinning LiDARs and range grids. A clockwise head reaches
// the azimuth theta at the time -theta / (2 pi) * period. An image column has one
// azimuth, and contains for each beam the firing whose ray is nearest to this azimuth.
// Therefore a beam with an azimuth offset is shifted by an integer number of columns.
// A beam measures:
//   range_measured = range + range_offset
//   intensity_measured = clamp(gain * fall * intensity + offset, 0, 1)
#include <relidar/log/sensor.hpp>

#include <algorithm>
#include <cmath>
#include <numeric>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>

#include "base/fail.hpp"
#include "base/parallel.hpp"
#include "log/sensor/beam_geometry.hpp"

namespace relidar {
namespace {

/// Returns a table of rows x columns rays, which the caller fills in.
RayTable make_ray_table(int rows, int columns, double divergence_rad) {
    RayTable rays;
    rays.rows = rows;
    rays.columns = columns;
    const std::size_t n = std::size_t(rows) * std::size_t(columns);
    rays.origin.resize(n);
    rays.direction.resize(n);
    rays.time_offset_s.resize(n);
    rays.channel.resize(n);
    rays.divergence_rad = float(divergence_rad);
    return rays;
}

/// Checks the values of a sensor before its rays are computed, because a program can set
/// any values.
/// @throws UsageError naming the value that is wrong
void check_spinning(const SpinningSensor& sensor) {
    const auto check = [&](bool is_right, const std::string& value, const std::string& expected) {
        if (!is_right) fail<UsageError>("sensor '{}': found {}, expected {}", sensor.name, value, expected);
    };
    const std::size_t n_beams = sensor.beams.size();
    check(n_beams > 0 && n_beams <= 65535, fmt::format("{} beams", n_beams), "1 to 65535");
    check(sensor.columns > 0, fmt::format("{} columns per sweep", sensor.columns), "at least one");
    check(n_beams * std::size_t(sensor.columns) <= kMaxRays,
          fmt::format("{} beams and {} columns", n_beams, sensor.columns),
          fmt::format("at most {} rays per sweep", kMaxRays));
    check(sensor.min_range_m >= 0.0 && sensor.max_range_m > sensor.min_range_m,
          fmt::format("range limits of {} to {} m", sensor.min_range_m, sensor.max_range_m),
          "0 <= min_range_m < max_range_m");
    check(sensor.period_s > 0.0 && std::isfinite(sensor.period_s),
          fmt::format("a period of {} s", sensor.period_s), "a positive number");
    // A sum is not finite if one of its values is not.
    double sum = sensor.first_azimuth_rad + sensor.divergence_rad;
    for (const Beam& beam : sensor.beams)
        sum += beam.elevation_rad + beam.azimuth_offset_rad + beam.origin_offset_m + beam.origin_up_m +
               beam.origin_left_m + beam.intensity_gain + beam.intensity_offset + beam.range_offset_m;
    check(std::isfinite(sum), "an angle, an offset or a gain that is not finite", "finite numbers");
}

}  // namespace

/// Returns the ranges that are within both limits.
RangeLimits intersect(const RangeLimits& first, const RangeLimits& second) {
    const RangeLimits both{std::max(first.min_m, second.min_m), std::min(first.max_m, second.max_m)};
    if (!(both.max_m > both.min_m))
        fail<UsageError>(
            "no range is within all limits: the largest minimum is {} m and the smallest maximum is {} m; "
            "expected dataset.min_range_m below dataset.max_range_m and below the maximum range of the "
            "sensor",
            both.min_m, both.max_m);
    return both;
}

BeamRay aim_beam(const Beam& beam, double head_azimuth_rad) {
    return BeamRays(beam).compute_ray(head_azimuth_rad);
}

double azimuth_facing_rad(const Beam& beam, const glm::dvec3& point_m) {
    return BeamRays(beam).azimuth_facing(point_m);
}

int offset_columns(const Beam& beam, int n_columns) {
    return int(std::lround(beam.azimuth_offset_rad / (2.0 * kPi) * n_columns));
}

std::vector<int> fired_columns(const SpinningSensor& sensor) {
    constexpr double kSlack_rad = 1e-9, kTurn_rad = 2.0 * kPi;
    std::vector<int> columns(std::size_t(std::max(sensor.columns, 0)));
    std::iota(columns.begin(), columns.end(), 0);
    if (!sensor.azimuth_rad) return columns;
    const double first_rad = (*sensor.azimuth_rad)[0], last_rad = (*sensor.azimuth_rad)[1];
    if (std::abs(last_rad - first_rad) > kTurn_rad - kSlack_rad) return columns;

    const double direction = sensor.clockwise ? -1.0 : 1.0;
    // Angle that the head turns from the first ray to an azimuth, 0 to a full turn. The
    // slack keeps a rounding error from turning 0 into a full turn.
    const auto turned_rad = [&](double azimuth_rad) {
        const double rad = direction * (azimuth_rad - first_rad) + kSlack_rad;
        return rad - kTurn_rad * std::floor(rad / kTurn_rad);
    };
    // A column does not fire if the head passes it after the last ray. Column numbers
    // increase clockwise, also if the head turns the other way.
    std::erase_if(columns, [&](int column) {
        const double azimuth_rad = sensor.first_azimuth_rad - column * kTurn_rad / sensor.columns;
        return turned_rad(azimuth_rad) > turned_rad(last_rad) + kSlack_rad;
    });
    return columns;
}

/// Returns the rays of one sweep: a row for each beam, a column for each azimuth at which
/// the sensor fires. Times are relative to the moment when the head faces forward.
RayTable make_rays(const SpinningSensor& sensor) {
    check_spinning(sensor);
    const std::vector<int> fired = fired_columns(sensor);
    if (fired.empty())
        fail<UsageError>("sensor '{}': found no column within azimuth_deg, expected a wider field of view",
                         sensor.name);
    const int rows = int(sensor.beams.size()), columns = sensor.columns;
    RayTable rays = make_ray_table(rows, int(fired.size()), sensor.divergence_rad);
    // Seconds per radian to the left; a clockwise head turns to the right.
    const double seconds_per_rad = (sensor.clockwise ? -1.0 : 1.0) * sensor.period_s / (2.0 * kPi);
    parallel_for(rows, [&](int row) {
        const Beam& beam = sensor.beams[std::size_t(row)];
        const BeamRays geometry(beam);
        const int shift = offset_columns(beam, columns);
        for (std::size_t k = 0; k < fired.size(); ++k) {
            // The beam points to the azimuth of this column when the head is `shift`
            // columns further. The second modulo makes negative columns positive.
            const int head_column = ((fired[k] + shift) % columns + columns) % columns;
            double head_rad = sensor.first_azimuth_rad - head_column * 2.0 * kPi / columns;
            // To [-pi, pi], without changing -pi and pi.
            if (std::abs(head_rad) > kPi) head_rad = std::remainder(head_rad, 2.0 * kPi);
            const BeamRay ray = geometry.compute_ray(head_rad);
            const std::size_t index = std::size_t(row) * fired.size() + k;
            rays.origin[index] = glm::vec3(ray.origin_m);
            rays.direction[index] = glm::vec3(ray.direction);
            rays.time_offset_s[index] = float(head_rad * seconds_per_rad);
            rays.channel[index] = std::uint16_t(row);
        }
    });
    return rays;
}

SpinningSensor make_grid_sensor(const RangeImageGrid& grid) {
    SpinningSensor sensor{.name = grid.name,
                          .beams = {},
                          .columns = grid.columns,
                          .first_azimuth_rad = kPi,
                          .max_range_m = grid.max_range_m};
    for (int row = 0; row < grid.rows; ++row)
        sensor.beams.push_back({.elevation_rad = grid.fov_up_rad - row * grid.fov_rad / grid.rows});
    return sensor;
}

RayTable make_rays(const RangeImageGrid& grid) { return make_rays(make_grid_sensor(grid)); }

double Beam::to_measured_range_m(double surface_range_m) const {
    return surface_range_m > 0.0 ? std::max(surface_range_m + range_offset_m, 0.0) : surface_range_m;
}

double Beam::to_surface_range_m(double measured_range_m) const {
    return measured_range_m > 0.0 ? std::max(measured_range_m - range_offset_m, 1e-3) : measured_range_m;
}

double Beam::to_measured_intensity(double surface_intensity, double intensity_factor_at_range) const {
    return std::clamp(intensity_gain * intensity_factor_at_range * surface_intensity + intensity_offset, 0.0,
                      1.0);
}

double Beam::to_surface_intensity(double measured_intensity, double intensity_factor_at_range) const {
    return (measured_intensity - intensity_offset) / intensity_gain / intensity_factor_at_range;
}

const Beam& find_beam(const std::vector<Beam>& beams, std::size_t channel) {
    static const Beam ideal;
    return channel < beams.size() ? beams[channel] : ideal;
}

}  // namespace relidar
