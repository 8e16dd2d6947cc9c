// SPDX-License-Identifier: Apache-2.0
// Plates and a static sensor at exact positions, for tests of rendered scans.
#pragma once

#include <cmath>

#include <relidar/simulate/render.hpp>

namespace relidar::test {

/// Opaque surfel with returns of intensity 0.5. Its normal is the x axis, or the z axis.
inline Surfels make_plate(const glm::vec3& middle_m, const glm::vec2& scale_m, bool is_level = false) {
    Surfels plate;
    plate.resize(1);
    plate.mean[0] = middle_m;
    plate.rotation[0] = {1.0f, 0.0f, 0.0f, 0.0f};
    if (!is_level) plate.rotation[0] = {std::sqrt(0.5f), 0.0f, std::sqrt(0.5f), 0.0f};
    plate.log_scale[0] = {std::log(scale_m.x), std::log(scale_m.y)};
    plate.opacity_logit[0] = 6.0f;
    std::fill(plate.sh.begin(), plate.sh.end(), 0.0f);
    plate.sh[kShCoefficients] = 20.0f;  // hit logit
    return plate;
}

/// A static LiDAR at the origin. Column 0 is behind it, and all rays have the same time.
inline Log make_static_log(const std::vector<double>& elevations_rad, int columns) {
    Log log;
    for (const double elevation_rad : elevations_rad) log.lidars[0].sensor.beams.push_back({elevation_rad});
    log.lidars[0].sensor.columns = columns;
    log.lidars[0].sensor.first_azimuth_rad = kPi;
    log.rolling_shutter = false;
    log.world_from_vehicle = {{0.0}, {Pose{}}};
    return log;
}

/// Completes a scan that has directions and ranges: rays from the origin that return with
/// intensity 0.5, in one row.
inline RenderedScan complete(RenderedScan scan) {
    const std::size_t n = scan.image.range_m.size();
    if (scan.image.rows == 0) {
        scan.image.rows = 1;
        scan.image.columns = int(n);
    }
    const auto fill = [n](auto& values, auto value) {
        if (values.empty()) values.assign(n, value);
    };
    fill(scan.image.origin, glm::vec3(0.0f));
    fill(scan.image.intensity, 0.5f);
    fill(scan.image.drop_prob, 0.0f);
    if (scan.median_range_m.empty()) scan.median_range_m = scan.image.range_m;
    if (scan.mean_range_m.empty()) scan.mean_range_m = scan.image.range_m;
    fill(scan.weight, 1.0f);
    fill(scan.instance, 0);
    fill(scan.time_offset_s, 0.0f);
    fill(scan.ring, std::uint16_t(0));
    return scan;
}

}  // namespace relidar::test
