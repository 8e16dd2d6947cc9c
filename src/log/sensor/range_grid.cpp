// SPDX-License-Identifier: Apache-2.0
// Projects points into an image whose rows are evenly spaced in elevation, and whose
// columns are evenly spaced in azimuth (paper Eq. 6-7). The ray of a pixel passes through
// its centre.
//   row = round((fov_up - elevation) / fov * rows)
//   column = round((1 - azimuth / pi) / 2 * columns) mod columns
#include <relidar/log/sensor.hpp>

#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>

#include "base/fail.hpp"

namespace relidar {

RangeImageGrid kitti360_grid() {
    return {.name = "kitti360",
            .rows = 66,
            .columns = 1030,
            .fov_up_rad = 2.0 * kPi / 180.0,
            .fov_rad = 26.9 * kPi / 180.0,
            .max_range_m = 80.0};
}

RangeImageGrid find_grid(const std::string& name) {
    if (find_name(name, {"kitti360"})) return kitti360_grid();
    fail<UsageError>("the range image grid '{}' is unknown, expected kitti360", name);
}

std::optional<int> project_to_pixel(const RangeImageGrid& grid, const glm::dvec3& point_m) {
    const double range = glm::length(point_m);
    if (!(range > 0.0) || range > grid.max_range_m) return std::nullopt;
    const double elevation = std::asin(glm::clamp(point_m.z / range, -1.0, 1.0));  // Eq. 6
    const double azimuth = std::atan2(point_m.y, point_m.x);
    const double row = std::round((grid.fov_up_rad - elevation) / grid.fov_rad * grid.rows);  // Eq. 7
    if (!(row >= 0.0) || row >= grid.rows) return std::nullopt;
    const long column = std::lround((1.0 - azimuth / kPi) / 2.0 * grid.columns) % grid.columns;
    return int(row) * grid.columns + int(column);
}

ProjectedRangeImage project_points(const RangeImageGrid& grid, const std::vector<glm::vec3>& points_m,
                                   const std::vector<float>& intensity) {
    if (points_m.size() != intensity.size())
        fail<UsageError>("project_points: intensity has {} entries, expected {} like points_m",
                         intensity.size(), points_m.size());
    ProjectedRangeImage image;
    image.rows = grid.rows;
    image.columns = grid.columns;
    const std::size_t n_pixels = std::size_t(grid.rows) * std::size_t(grid.columns);
    image.range_m.assign(n_pixels, 0.0f);
    image.intensity.assign(n_pixels, 0.0f);
    image.source.assign(n_pixels, -1);  // index of the point of each pixel; -1: none
    for (std::size_t i = 0; i < points_m.size(); ++i) {
        const std::optional<int> pixel = project_to_pixel(grid, glm::dvec3(points_m[i]));
        if (!pixel) continue;
        const auto p = std::size_t(*pixel);
        const float range_m = glm::length(points_m[i]);
        // The nearest point of a pixel wins, as in a depth buffer.
        if (image.source[p] >= 0 && image.range_m[p] <= range_m) continue;
        image.range_m[p] = range_m;
        image.intensity[p] = intensity[i];
        image.source[p] = int(i);
    }
    return image;
}

}  // namespace relidar
