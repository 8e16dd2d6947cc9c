// SPDX-License-Identifier: Apache-2.0
// Estimates the beams and columns of a spinning LiDAR from its points. The elevation of a
// ring is the median over its points. The number of columns is computed from azimuth
// steps. The azimuth offsets of the rings are computed from the phases of
//   S_r(N) = sum of exp(i N azimuth) over the points of ring r.
// If N is the number of columns, |S_r| is the number of points, and the phase of S_r is N
// times the azimuth offset of the ring.
#include <relidar/log/clouds.hpp>

#include <algorithm>
#include <cmath>
#include <complex>
#include <numeric>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

namespace relidar {
namespace {

constexpr double kLeastStep_rad = 2e-4;  // minimum azimuth step between two firings (about 0.01 degrees)
constexpr double kLargestStep_rad = 0.2;
// Numbers of columns that differ from the first estimate by at most this share are
// tested.
constexpr double kTried = 0.03;
// The azimuths are on a regular grid if |S_r|, summed over the rings and divided by the
// number of points, is above this value.
constexpr double kCoherent = 0.5;
// The number of columns is increased to the number of points in the fullest ring, at most
// by this factor.
constexpr double kMostColumns = 1.1;
constexpr std::size_t kFewestSteps = 16;
constexpr std::size_t kMostRings = 4096;

double compute_azimuth(const glm::vec3& point) { return std::atan2(double(point.y), double(point.x)); }

double interpolate_quantile(std::vector<double>& values, double share) {
    const auto at = values.begin() + std::ptrdiff_t(share * double(values.size() - 1));
    std::nth_element(values.begin(), at, values.end());
    return *at;
}

/// Points of one ring, without second returns: their indices and azimuths.
struct Ring {
    std::vector<std::size_t> point;
    std::vector<double> azimuth_rad;
};
using Rings = std::vector<Ring>;

Rings group_points_by_ring(const Points& scan, std::size_t n_rings) {
    Rings rings(n_rings);
    for (std::size_t i = 0; i < scan.size(); ++i) {
        if (!scan.return_number.empty() && scan.return_number[i] != 1) continue;
        rings[scan.ring[i]].point.push_back(i);
        rings[scan.ring[i]].azimuth_rad.push_back(compute_azimuth(scan.position_m[i]));
    }
    return rings;
}

/// Returns the median elevation of each ring, or nothing for a ring without points. Uses
/// only the farther half of the points. Near points are less accurate, because a beam
/// does not start exactly at the sensor origin.
std::vector<std::optional<double>> estimate_elevations(const std::vector<Points>& scans,
                                                       std::size_t n_rings) {
    struct Seen {
        double range_m, elevation_rad;
    };
    std::vector<std::vector<Seen>> seen(n_rings);
    for (const Points& scan : scans)
        for (std::size_t i = 0; i < scan.size(); ++i) {
            const glm::dvec3 p(scan.position_m[i]);
            seen[scan.ring[i]].push_back({glm::length(p), std::atan2(p.z, std::hypot(p.x, p.y))});
        }
    std::vector<std::optional<double>> elevations(n_rings);
    for (std::size_t r = 0; r < n_rings; ++r) {
        if (seen[r].empty()) continue;
        const auto half = seen[r].begin() + std::ptrdiff_t(seen[r].size() / 2);
        std::nth_element(seen[r].begin(), half, seen[r].end(), [](const Seen& first, const Seen& second) {
            return first.range_m < second.range_m;
        });
        std::vector<double> far;
        for (auto s = half; s != seen[r].end(); ++s) far.push_back(s->elevation_rad);
        elevations[r] = interpolate_quantile(far, 0.5);
    }
    return elevations;
}

/// Estimates the number of columns per revolution from the azimuth steps between
/// neighbouring points of a ring. Uses the lower quartile of the steps, because steps
/// across dropped rays are longer.
int estimate_column_count(const Points& scan, const Rings& rings) {
    std::vector<double> steps;
    for (const Ring& ring : rings) {
        std::vector<double> azimuths = ring.azimuth_rad;
        std::sort(azimuths.begin(), azimuths.end());
        for (std::size_t i = 1; i < azimuths.size(); ++i)
            if (const double step = azimuths[i] - azimuths[i - 1];
                step > kLeastStep_rad && step < kLargestStep_rad)
                steps.push_back(step);
    }
    if (steps.size() < kFewestSteps)
        throw DataError(
            fmt::format("cannot fit a spinning LiDAR to {} points in {} rings: only {} azimuth "
                        "steps between neighbouring points are usable, expected at least {}",
                        scan.size(), rings.size(), steps.size(), kFewestSteps));
    return int(std::lround(2.0 * kPi / interpolate_quantile(steps, 0.25)));
}

/// Returns S_r(N), the sum of exp(i N azimuth) over the points of ring r, for each ring.
/// |S_r| is large if the azimuths are on a grid of N columns.
std::vector<std::complex<double>> compute_column_phases(const Rings& rings, int columns) {
    std::vector<std::complex<double>> sums;
    for (const Ring& ring : rings) {
        std::complex<double> sum = 0.0;
        for (const double azimuth : ring.azimuth_rad) sum += std::polar(1.0, columns * azimuth);
        sums.push_back(sum);
    }
    return sums;
}

/// Returns the sum of |S_r(N)| over all rings r, for `count` consecutive numbers of
/// columns N, starting with `first`.
std::vector<double> compute_phase_lengths(const Rings& rings, int first, std::size_t count) {
    std::vector<double> lengths(count, 0.0);
    for (const Ring& ring : rings) {
        std::vector<std::complex<double>> turned, step;
        for (const double azimuth : ring.azimuth_rad) {
            turned.push_back(std::polar(1.0, first * azimuth));
            step.push_back(std::polar(1.0, azimuth));
        }
        for (double& length : lengths) {
            std::complex<double> sum = 0.0;
            for (std::size_t k = 0; k < turned.size(); ++k) {
                sum += turned[k];
                turned[k] *= step[k];
            }
            length += std::abs(sum);
        }
    }
    return lengths;
}

struct Lattice {
    int columns = 0;
    /// [rings] azimuth offset of each ring, at most half an azimuth step
    std::vector<double> offset_rad;
};

Lattice find_lattice(const Points& scan, const Rings& rings) {
    Lattice lattice{estimate_column_count(scan, rings), std::vector<double>(rings.size(), 0.0)};
    const int reach = std::max(1, int(kTried * lattice.columns)),
              first = std::max(1, lattice.columns - reach);
    const std::vector<double> lengths =
        compute_phase_lengths(rings, first, std::size_t(lattice.columns + reach + 1 - first));
    const auto best = std::ranges::max_element(lengths);
    if (*best <= kCoherent * double(scan.size())) {
        // A ring has at most one first return per column. Therefore the fullest ring
        // gives the number of columns.
        std::size_t most = 0;
        for (const Ring& ring : rings) most = std::max(most, ring.point.size());
        lattice.columns = std::clamp(int(std::min<std::size_t>(most, kMaxRays)), lattice.columns,
                                     int(kMostColumns * lattice.columns));
        return lattice;
    }
    lattice.columns = first + int(best - lengths.begin());
    const std::vector<std::complex<double>> sums = compute_column_phases(rings, lattice.columns);
    const std::complex<double> common = std::accumulate(sums.begin(), sums.end(), std::complex<double>(0.0));
    for (std::size_t r = 0; r < rings.size(); ++r)
        lattice.offset_rad[r] =
            sums[r] == 0.0 ? 0.0 : std::arg(sums[r] * std::conj(common)) / lattice.columns;
    return lattice;
}

/// Estimates the rotation rate of the LiDAR's head in radians per second, positive if
/// counterclockwise. Returns nothing if the points have no times.
std::optional<double> estimate_turning_rate(const Points& scan, const Rings& rings) {
    if (scan.time_offset_s.empty()) return std::nullopt;
    double turned = 0.0, passed_s = 0.0;
    for (const Ring& ring : rings) {
        const auto time_of = [&](std::size_t index) { return scan.time_offset_s[ring.point[index]]; };
        std::vector<std::size_t> order(ring.point.size());
        std::iota(order.begin(), order.end(), std::size_t(0));
        std::sort(order.begin(), order.end(),
                  [&](std::size_t first, std::size_t second) { return time_of(first) < time_of(second); });
        for (std::size_t k = 1; k < order.size(); ++k) {
            const double step =
                std::remainder(ring.azimuth_rad[order[k]] - ring.azimuth_rad[order[k - 1]], 2.0 * kPi);
            if (std::abs(step) > kLargestStep_rad) continue;
            turned += step;
            passed_s += double(time_of(order[k])) - double(time_of(order[k - 1]));
        }
    }
    if (!(passed_s > 0.0) || turned == 0.0) return std::nullopt;
    return turned / passed_s;
}

}  // namespace

FittedSensor fit_sensor(const std::vector<Points>& scans, double period_s) {
    std::size_t n_rings = 0;
    const Points* fullest = nullptr;
    for (const Points& scan : scans) {
        if (scan.ring.size() != scan.size())
            throw UsageError(
                fmt::format("cannot fit a spinning LiDAR: found {} ring numbers for {} points, expected "
                            "one per point",
                            scan.ring.size(), scan.size()));
        for (const std::uint16_t ring : scan.ring) n_rings = std::max(n_rings, std::size_t(ring) + 1);
        if (!fullest || scan.size() > fullest->size()) fullest = &scan;
    }
    if (n_rings == 0)
        throw UsageError(
            "cannot fit a spinning LiDAR: there are no points, expected the "
            "points of a few scans");
    if (n_rings > kMostRings)
        throw DataError(
            fmt::format("cannot fit a spinning LiDAR: a point has ring {}, expected a number "
                        "below {}",
                        n_rings - 1, kMostRings));
    const Rings rings = group_points_by_ring(*fullest, n_rings);
    const Lattice lattice = find_lattice(*fullest, rings);
    const std::vector<std::optional<double>> elevations = estimate_elevations(scans, n_rings);

    std::vector<std::size_t> order;  // ring numbers, sorted from the highest to the lowest ring
    for (std::size_t r = 0; r < n_rings; ++r)
        if (elevations[r]) order.push_back(r);
    std::stable_sort(order.begin(), order.end(), [&](std::size_t first, std::size_t second) {
        return *elevations[first] > *elevations[second];
    });
    FittedSensor fitted{{}, std::vector<std::uint16_t>(n_rings, kNoBeam)};
    SpinningSensor& sensor = fitted.sensor;
    for (const std::size_t r : order) {
        fitted.beam_of_ring[r] = std::uint16_t(sensor.beams.size());
        sensor.beams.push_back(
            {.elevation_rad = *elevations[r], .azimuth_offset_rad = lattice.offset_rad[r]});
    }
    const std::optional<double> rate = estimate_turning_rate(*fullest, rings);
    sensor.columns = lattice.columns;
    sensor.first_azimuth_rad = kPi - kPi / lattice.columns;
    sensor.period_s = rate ? 2.0 * kPi / std::abs(*rate) : period_s;
    sensor.clockwise = !rate || *rate < 0.0;
    return fitted;
}

}  // namespace relidar
