// SPDX-License-Identifier: Apache-2.0
// Generates the ray tables of spinning LiDARs and range grids. A clockwise head reaches
// the azimuth theta at the time -theta / (2 pi) * period. An image column has one
// azimuth, and contains for each beam the firing whose ray is nearest to this azimuth.
// Therefore a beam with an azimuth offset is shifted by an integer number of columns.
#include <relidar/log/sensor.hpp>

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>

#include "base/fail.hpp"
#include "base/parallel.hpp"
#include "log/sensor/beam_geometry.hpp"

namespace relidar {
namespace {

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

void check_spinning(const SpinningSensor& sensor) {
    const auto refuse = [&](const std::string& text) {
        fail<UsageError>("sensor '{}': found {}", sensor.name, text);
    };
    if (sensor.beams.empty()) refuse("no beams, expected at least one");
    if (sensor.beams.size() > 65535)
        refuse(fmt::format("{} beams, expected at most 65535", sensor.beams.size()));
    if (sensor.columns <= 0)
        refuse(fmt::format("{} columns per sweep, expected at least one", sensor.columns));
    if (sensor.beams.size() * std::size_t(sensor.columns) > kMaxRays)
        refuse(fmt::format("{} beams and {} columns, which are {} rays per sweep; expected at most {} rays",
                           sensor.beams.size(), sensor.columns,
                           sensor.beams.size() * std::size_t(sensor.columns), kMaxRays));
    if (!(sensor.min_range_m >= 0.0 && sensor.max_range_m > sensor.min_range_m))
        refuse(fmt::format("range limits of {} to {} m, expected 0 <= min_range_m < max_range_m",
                           sensor.min_range_m, sensor.max_range_m));
    if (!(sensor.period_s > 0.0) || !std::isfinite(sensor.period_s))
        refuse(fmt::format("a period of {} s, expected a positive number", sensor.period_s));
    if (!std::isfinite(sensor.first_azimuth_rad) || !std::isfinite(sensor.divergence_rad))
        refuse(fmt::format("first_azimuth_rad = {} and divergence_rad = {}, expected finite numbers",
                           sensor.first_azimuth_rad, sensor.divergence_rad));
    for (std::size_t b = 0; b < sensor.beams.size(); ++b) {
        const Beam& beam = sensor.beams[b];
        // The sum is not finite if one of the values is not.
        const double sum = beam.elevation_rad + beam.azimuth_offset_rad + beam.origin_offset_m +
                           beam.origin_up_m + beam.origin_left_m + beam.intensity_gain +
                           beam.intensity_offset + beam.range_offset_m;
        if (!std::isfinite(sum))
            refuse(fmt::format(
                "an angle, an offset or a gain of beam {} that is not finite, expected finite numbers", b));
    }
}

}  // namespace

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
    std::vector<int> columns;
    const double direction = sensor.clockwise ? -1.0 : 1.0;
    const auto turned_rad = [&](double azimuth_rad) {  // since the first ray of a turn, 0 to a full turn
        // The slack keeps a rounding error from turning 0 into a full turn.
        const double rad = direction * (azimuth_rad - (*sensor.azimuth_rad)[0]) + kSlack_rad;
        return rad - kTurn_rad * std::floor(rad / kTurn_rad);
    };
    const bool fires_always =
        !sensor.azimuth_rad ||
        std::abs((*sensor.azimuth_rad)[1] - (*sensor.azimuth_rad)[0]) > kTurn_rad - kSlack_rad;
    for (int column = 0; column < sensor.columns; ++column)
        // A column fires if the head passes it before the end of the field of view.
        if (fires_always || turned_rad(sensor.first_azimuth_rad - column * kTurn_rad / sensor.columns) <=
                                turned_rad((*sensor.azimuth_rad)[1]) + kSlack_rad)
            columns.push_back(column);
    return columns;
}

RayTable make_rays(const SpinningSensor& sensor) {
    check_spinning(sensor);
    const std::vector<int> fired = fired_columns(sensor);
    if (fired.empty())
        fail<UsageError>("sensor '{}': found no column within azimuth_deg, expected a wider field of view",
                         sensor.name);
    const int rows = int(sensor.beams.size()), columns = sensor.columns;
    RayTable rays = make_ray_table(rows, int(fired.size()), sensor.divergence_rad);
    const double seconds_per_rad = (sensor.clockwise ? -1.0 : 1.0) * sensor.period_s / (2.0 * kPi);
    parallel_for(rows, [&](int row) {
        const Beam& beam = sensor.beams[std::size_t(row)];
        const BeamRays geometry(beam);
        const int shift = offset_columns(beam, columns);
        std::size_t at = std::size_t(row) * fired.size();
        for (const int column : fired) {
            // The beam points to the azimuth of this column when the head is `shift`
            // columns away.
            const int firing = ((column + shift) % columns + columns) % columns;
            const double azimuth_rad = sensor.first_azimuth_rad - firing * 2.0 * kPi / columns;
            // to [-pi, pi], without changing -pi and pi
            const double head =
                std::abs(azimuth_rad) <= kPi ? azimuth_rad : std::remainder(azimuth_rad, 2.0 * kPi);
            const BeamRay ray = geometry.compute_ray(head);
            rays.origin[at] = glm::vec3(ray.origin_m);
            rays.direction[at] = glm::vec3(ray.direction);
            rays.time_offset_s[at] = float(head * seconds_per_rad);
            rays.channel[at++] = std::uint16_t(row);
        }
    });
    return rays;
}

RayTable make_rays(const RangeImageGrid& grid) {
    SpinningSensor sensor;
    sensor.name = grid.name;
    sensor.columns = grid.columns;
    // Inverse of project_to_pixel(): column 0 faces backward.
    sensor.first_azimuth_rad = kPi;
    for (int row = 0; row < grid.rows; ++row) {
        sensor.beams.push_back({.elevation_rad = grid.fov_up_rad - row * grid.fov_rad / grid.rows});
    }
    return make_rays(sensor);
}

}  // namespace relidar
