// SPDX-License-Identifier: Apache-2.0
#include "simulate/render/level_ground.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <unordered_map>

#include "base/cell_key.hpp"
#include "base/parallel.hpp"

namespace relidar {
namespace {

constexpr double kCell_m = 2.0;
// Points at most this high above the lowest point of a cell can be ground.
constexpr double kLayer_m = 0.25;
constexpr double kFlat_m = 0.1;     // maximum root mean square distance of the points from the plane
constexpr double kSteepest = 0.25;  // maximum slope of ground, rise over run
constexpr double kFewest = 6.0;     // minimum number of points for a plane
// If the points form a narrower strip than this, they do not determine the slope across
// the strip. The slope is then 0 in that direction.
constexpr double kWidth_m = 0.2;

/// Statistics of the points in a cell. Holds the lowest height. For points near that
/// height, holds the number and the sums of x, y, z and of their products. Coordinates
/// are relative to the sensor, along the axes of the world.
struct Cell {
    double lowest_m = std::numeric_limits<double>::infinity();
    double n = 0.0, zz = 0.0;
    glm::dvec3 sum{0.0};       // sums of x, y, z
    glm::dvec3 squares{0.0};   // sums of xx, xy, yy
    glm::dvec2 products{0.0};  // sums of xz, yz

    void add(const glm::dvec3& p) {
        n += 1.0, zz += p.z * p.z, sum += p;
        squares += glm::dvec3(p.x * p.x, p.x * p.y, p.y * p.y), products += p.z * glm::dvec2(p);
    }
    void add(const Cell& other) {
        n += other.n, zz += other.zz, sum += other.sum;
        squares += other.squares, products += other.products;
    }
};
using Cells = std::unordered_map<std::uint64_t, Cell>;

std::uint64_t key_of(const glm::dvec3& p) { return cell_key({p.x, p.y, 0.0}, kCell_m); }

/// Plane z = height + slope . (x, y) of the ground.
struct GroundPlane {
    double height_m = 0.0;
    glm::dvec2 slope{0.0};
    bool is_ground = false;

    double above(const glm::dvec3& p) const { return p.z - height_m - glm::dot(slope, glm::dvec2(p)); }
};

GroundPlane fit_plane(const Cell& c) {
    if (c.n < kFewest) return {};
    const glm::dvec3 mean = c.sum / c.n;
    const double ridge = kWidth_m * kWidth_m, xx = c.squares.x / c.n - mean.x * mean.x + ridge,
                 xy = c.squares.y / c.n - mean.x * mean.y, yy = c.squares.z / c.n - mean.y * mean.y + ridge,
                 zz = c.zz / c.n - mean.z * mean.z;
    const glm::dvec2 right = c.products / c.n - mean.z * glm::dvec2(mean);
    const glm::dvec2 slope =
        glm::dvec2(yy * right.x - xy * right.y, xx * right.y - xy * right.x) / (xx * yy - xy * xy);
    // Variance of the height that the plane does not explain. The term `ridge` makes it
    // slightly larger.
    const double squared_m2 = zz - glm::dot(slope, right);
    return {mean.z - glm::dot(slope, glm::dvec2(mean)), slope,
            squared_m2 < kFlat_m * kFlat_m && glm::length(slope) < kSteepest};
}

/// Returns the points where rays hit the background below the sensor, relative to the
/// sensor. The result is NaN for other rays.
std::vector<glm::dvec3> points_below(const RenderedScan& scan) {
    const glm::dvec3 none(std::numeric_limits<double>::quiet_NaN());
    std::vector<glm::dvec3> points(scan.median_range_m.size(), none);
    for_each_block(points.size(), [&](std::size_t ray) {
        if (scan.instance[ray] != 0 || !returned(scan.image.drop_prob[ray], scan.median_range_m[ray])) return;
        const glm::dvec3 of_sensor(scan.image.origin[ray] +
                                   scan.median_range_m[ray] * scan.image.direction[ray]);
        const glm::dvec3 p = scan.world_from_firing(ray) * of_sensor - scan.world_from_sensor.translation;
        if (p.z < 0.0) points[ray] = p;
    });
    return points;
}

Cells fill_cells(const std::vector<glm::dvec3>& points) {
    Cells cells;
    for (const glm::dvec3& p : points)
        if (!std::isnan(p.x)) {
            double& lowest_m = cells[key_of(p)].lowest_m;
            lowest_m = std::min(lowest_m, p.z);
        }
    for (const glm::dvec3& p : points)
        if (!std::isnan(p.x))
            if (Cell& cell = cells[key_of(p)]; p.z < cell.lowest_m + kLayer_m) cell.add(p);
    return cells;
}

/// Fits a plane to the points in the cell of p and in the eight neighbouring cells.
GroundPlane plane_at(const Cells& cells, const glm::dvec3& p) {
    Cell together;
    for (int dx = -1; dx <= 1; ++dx)
        for (int dy = -1; dy <= 1; ++dy)
            if (const auto cell = cells.find(key_of(p + kCell_m * glm::dvec3(dx, dy, 0)));
                cell != cells.end())
                together.add(cell->second);
    return fit_plane(together);
}

}  // namespace

std::vector<glm::dvec3> level_ground(const RenderedScan& scan) {
    const std::vector<glm::dvec3> points = points_below(scan);
    const Cells cells = fill_cells(points);
    std::unordered_map<std::uint64_t, GroundPlane> planes;
    std::vector<glm::dvec3> normals(points.size(), glm::dvec3(0.0));
    for (std::size_t ray = 0; ray < points.size(); ++ray) {
        const glm::dvec3& p = points[ray];
        if (std::isnan(p.x)) continue;
        const auto [plane, is_new] = planes.try_emplace(key_of(p));
        if (is_new) plane->second = plane_at(cells, p);
        if (plane->second.is_ground && std::abs(plane->second.above(p)) < kLayer_m)
            normals[ray] = glm::normalize(glm::dvec3(-plane->second.slope, 1.0));
    }
    return normals;
}

}  // namespace relidar
