// SPDX-License-Identifier: Apache-2.0
// Puts points of a KITTI turn on the rays that took them. Ray of laser k at head azimuth theta: beam_ray(beam_k, theta),
// range = |point - origin|, firing time = -theta / (2 pi) * period (clockwise, 0 = facing forward).
#include "dataset/kitti_grid.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include <relidar/math.hpp>

namespace relidar::kitti {
namespace {

constexpr int kEmpty = -1;

/// Index of the point in each cell [ring][firing], kEmpty = dropped.
struct Cells {
    std::size_t n_firings;
    std::vector<int> point;

    int& at(std::size_t ring, std::size_t firing) { return point[ring * n_firings + firing]; }
};

/// Firing nearest in time to each tick.
std::vector<int> nearest_firings(const std::vector<int>& firings, int n_ticks) {
    std::vector<int> nearest(static_cast<std::size_t>(n_ticks), kEmpty);
    for (std::size_t f = 0; f < firings.size(); ++f) nearest[static_cast<std::size_t>(firings[f])] = static_cast<int>(f);
    std::vector<int> filled = nearest;
    for (int t = 0; t < n_ticks; ++t) {
        for (int d = 1; filled[static_cast<std::size_t>(t)] == kEmpty && d < n_ticks; ++d) {
            const int below = nearest[static_cast<std::size_t>((t - d % n_ticks + n_ticks) % n_ticks)];
            filled[static_cast<std::size_t>(t)] = below != kEmpty ? below : nearest[static_cast<std::size_t>((t + d) % n_ticks)];
        }
    }
    return filled;
}

/// Firing that each column's slot shows: all in order, some twice where there are fewer firings than columns.
std::vector<int> fill_columns(const std::vector<int>& firings, const FiringLattice& lattice, int columns) {
    const std::size_t n = firings.size();
    std::vector<int> repeat(n, 1);
    int spare = columns - static_cast<int>(n);
    const double step = 2.0 * kPi / columns;
    for (std::size_t f = 0; f + 1 < n && spare > 0; ++f) {
        const double gap = lattice.azimuth_of(firings[f]) - lattice.azimuth_of(firings[f + 1]);
        const int missing = std::min(static_cast<int>(std::lround(gap / step)) - 1, spare);
        if (missing > 0) repeat[f] += missing, spare -= missing;
    }
    repeat.back() += std::max(spare, 0);
    std::vector<int> slot;
    for (std::size_t f = 0; f < n; ++f) slot.insert(slot.end(), static_cast<std::size_t>(repeat[f]), static_cast<int>(f));
    slot.resize(static_cast<std::size_t>(columns));
    return slot;
}

float range_of(const RawScan& raw, int point) {
    return glm::length(glm::vec3(raw.points[static_cast<std::size_t>(point)]));
}

/// Assigns points to cells; a second point of a cell moves to a free neighbour, else the nearer stays.
Cells assign(const RawScan& raw, const std::vector<int>& firings, const FiringLattice& lattice, double max_range_m, GriddedScan& out) {
    Cells cells{firings.size(), std::vector<int>(kRings * firings.size(), kEmpty)};
    const std::vector<int> nearest = nearest_firings(firings, lattice.n_ticks);
    const std::size_t n = firings.size();
    for (std::size_t i = 0; i < raw.points.size(); ++i) {
        const std::size_t ring = raw.ring[i];
        const double range = range_of(raw, static_cast<int>(i));
        if (range > max_range_m || range < 1e-3) {
            ++out.n_beyond;
            continue;
        }
        const int tick = lattice.tick(lattice.head_azimuth(raw.points[i], raw.ring[i]));
        const std::size_t firing = static_cast<std::size_t>(nearest[static_cast<std::size_t>(tick)]);
        int point = static_cast<int>(i);
        for (const std::size_t f : {firing, (firing + 1) % n, (firing + n - 1) % n}) {
            if (cells.at(ring, f) != kEmpty) continue;
            std::swap(cells.at(ring, f), point);
            break;
        }
        if (point == kEmpty) continue;
        ++out.n_lost;
        if (range < range_of(raw, cells.at(ring, firing))) cells.at(ring, firing) = point;
    }
    return cells;
}

/// Writes one cell: the point's own direction, or the modelled ray with range 0.
void set_ray(Scan& scan, std::size_t at, const Beam& beam, double head_rad, const glm::vec4* point) {
    const BeamRay model = beam_ray(beam, head_rad);
    scan.rays.origin[at] = glm::vec3(model.origin_m);
    scan.rays.direction[at] = glm::vec3(model.direction);
    if (!point) return;
    const glm::dvec3 p(*point);
    // The point's own azimuth, not the lattice's, sets its origin: exact too where the lattice is only even steps.
    const double reach = std::max(std::hypot(p.x, p.y), 1e-3);
    const double azimuth = std::atan2(p.y, p.x) - std::asin(glm::clamp(beam.origin_left_m / reach, -1.0, 1.0));
    const glm::dvec3 origin = beam_ray(beam, azimuth - beam.azimuth_offset_rad).origin_m;
    const double range = glm::length(p - origin);
    if (!(range > 1e-3)) return;
    scan.rays.origin[at] = glm::vec3(origin);
    scan.rays.direction[at] = glm::vec3((p - origin) / range);
    scan.range_m[at] = static_cast<float>(range);
    scan.intensity[at] = glm::clamp(point->w, 0.0f, 1.0f);
}

}  // namespace

std::vector<Beam> make_beams(const Cones& cones, const FiringLattice& lattice) {
    std::vector<Beam> beams(kRings);
    for (std::size_t k = 0; k < kRings; ++k) {
        const double elevation = std::atan(cones[k].tan_el);
        beams[k] = {elevation, lattice.offset_rad[k], 0.0, cones[k].z0_m * std::cos(elevation), lattice.left_m[k]};
    }
    return beams;
}

GriddedScan make_scan(const RawScan& raw, const std::vector<int>& firings, const Hdl64& hdl64, double max_range_m) {
    GriddedScan out;
    out.n_points = raw.points.size();
    Cells cells = assign(raw, firings, hdl64.lattice, max_range_m, out);
    const int columns = hdl64.sensor.columns;
    const std::vector<int> slot = fill_columns(firings, hdl64.lattice, columns);

    const std::size_t n = static_cast<std::size_t>(kRings) * static_cast<std::size_t>(columns);
    Scan& scan = out.scan;
    scan.rays.rows = kRings;
    scan.rays.columns = columns;
    scan.rays.divergence_rad = static_cast<float>(hdl64.sensor.divergence_rad);
    scan.rays.origin.resize(n);
    scan.rays.direction.resize(n);
    scan.rays.time_offset_s.resize(n);
    scan.rays.channel.resize(n);
    scan.range_m.assign(n, 0.0f);
    scan.intensity.assign(n, 0.0f);
    std::size_t at = 0;
    for (std::size_t ring = 0; ring < kRings; ++ring) {
        const Beam& beam = hdl64.sensor.beams[ring];
        const int shift = column_shift(beam, columns);
        for (int column = 0; column < columns; ++column, ++at) {
            const std::size_t firing =
                static_cast<std::size_t>(slot[static_cast<std::size_t>(((column + shift) % columns + columns) % columns)]);
            const double head = hdl64.lattice.azimuth_of(firings[firing]);
            const int point = cells.at(ring, firing);
            scan.rays.time_offset_s[at] = static_cast<float>(-head / (2.0 * kPi) * hdl64.sensor.period_s);
            scan.rays.channel[at] = static_cast<std::uint16_t>(ring);
            set_ray(scan, at, beam, head, point == kEmpty ? nullptr : &raw.points[static_cast<std::size_t>(point)]);
        }
    }
    return out;
}

}  // namespace relidar::kitti
