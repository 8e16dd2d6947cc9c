// SPDX-License-Identifier: Apache-2.0
// Rings of an HDL-64E from the order of the file, and their cones z = z0 + rho * tan(elevation) by least squares. The lens
// of each block of 32 lasers lies off the sensor's origin, so elevations seen from the origin would depend on range.
#include "dataset/hdl64_rings.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/error.hpp>
#include <relidar/math.hpp>

namespace relidar::kitti {
namespace {

struct Sample {
    double rho_m, z_m;
};

double residual(const Cone& cone, const Sample& s) { return s.z_m - cone.z0_m - s.rho_m * cone.tan_el; }

/// Line through the samples whose residual against `previous` is below a limit.
Cone fit_line(const std::vector<Sample>& samples, const Cone& previous, double limit_m) {
    double n = 0, sr = 0, sz = 0, srr = 0, srz = 0;
    for (const Sample& s : samples) {
        if (std::abs(residual(previous, s)) > limit_m) continue;
        n += 1, sr += s.rho_m, sz += s.z_m, srr += s.rho_m * s.rho_m, srz += s.rho_m * s.z_m;
    }
    const double spread = n * srr - sr * sr;
    if (n < 16 || spread < 0.25 * n * n) return {};  // ranges must spread by half a metre to part z0 from the slope
    const double slope = (n * srz - sr * sz) / spread;
    return {(sz - slope * sr) / n, slope, static_cast<std::size_t>(n)};
}

Cone fit_cone(const std::vector<Sample>& samples) {
    Cone cone = fit_line(samples, {}, INFINITY);
    for (int pass = 0; pass < 4 && cone.n > 0; ++pass) {
        std::vector<double> error;
        for (const Sample& s : samples) error.push_back(std::abs(residual(cone, s)));
        std::nth_element(error.begin(), error.begin() + static_cast<std::ptrdiff_t>(error.size() / 2), error.end());
        const double sigma = 1.4826 * error[error.size() / 2];  // of a normal distribution with this median deviation
        cone = fit_line(samples, cone, std::max(3.0 * sigma, 1e-3));
    }
    return cone;
}

/// Fills rings that have too few points: the slope between the neighbours, the height on its block's line z0(tan el).
void fill_gaps(Cones& cones, const std::string& where) {
    for (int block = 0; block < 2; ++block) {
        double n = 0, st = 0, sz = 0, stt = 0, stz = 0;
        const int first = block * kRings / 2, last = first + kRings / 2;
        std::vector<int> good;
        for (int k = first; k < last; ++k) {
            const Cone& c = cones[static_cast<std::size_t>(k)];
            if (c.n == 0) continue;
            good.push_back(k);
            n += 1, st += c.tan_el, sz += c.z0_m, stt += c.tan_el * c.tan_el, stz += c.tan_el * c.z0_m;
        }
        if (good.size() < 2) throw DataError(where + ": fewer than two lasers of a block of 32 can be fitted, expected an HDL-64E log");
        const double slope = (n * stz - st * sz) / std::max(n * stt - st * st, 1e-12);
        for (int k = first; k < last; ++k) {
            Cone& cone = cones[static_cast<std::size_t>(k)];
            if (cone.n > 0) continue;
            const auto next = std::lower_bound(good.begin() + 1, good.end() - 1, k);
            const Cone &a = cones[static_cast<std::size_t>(next[-1])], &b = cones[static_cast<std::size_t>(*next)];
            cone.tan_el = a.tan_el + (b.tan_el - a.tan_el) * (k - next[-1]) / static_cast<double>(*next - next[-1]);
            cone.z0_m = (sz + slope * (n * cone.tan_el - st)) / n;
        }
    }
}

/// Ring whose cone a run of points lies nearest to, by the median of some of its residuals.
int nearest_ring(const RawScan& scan, std::size_t begin, std::size_t end, const Cones& cones) {
    const std::size_t step = std::max<std::size_t>((end - begin) / 32, 1);
    int best = 0;
    double least = INFINITY;
    for (int k = 0; k < kRings; ++k) {
        std::vector<double> error;
        for (std::size_t i = begin; i < end; i += step) {
            const glm::dvec4 p(scan.points[i]);
            error.push_back(std::abs(residual(cones[static_cast<std::size_t>(k)], {std::hypot(p.x, p.y), p.z})));
        }
        std::nth_element(error.begin(), error.begin() + static_cast<std::ptrdiff_t>(error.size() / 2), error.end());
        if (error[error.size() / 2] < least) least = error[error.size() / 2], best = k;
    }
    return best;
}

}  // namespace

RawScan split_rings(std::vector<glm::vec4> points) {
    RawScan scan;
    scan.points = std::move(points);
    scan.ring.resize(scan.points.size());
    int ring = 0;
    bool fourth = false;  // the point before lies in the 4th quadrant (x >= 0, y < 0)
    for (std::size_t i = 0; i < scan.points.size(); ++i) {
        const glm::vec4& p = scan.points[i];
        if (fourth && p.x > 0.0f && p.y >= 0.0f) ++ring;
        fourth = p.x >= 0.0f && p.y < 0.0f;
        scan.ring[i] = static_cast<std::uint8_t>(std::min(ring, kRings - 1));
    }
    scan.n_rings = ring + 1;
    return scan;
}

Cones fit_cones(const std::vector<const RawScan*>& scans, const std::string& where) {
    std::array<std::vector<Sample>, kRings> samples;
    int most = 0;
    for (const RawScan* scan : scans) {
        most = std::max(most, scan->n_rings);
        if (scan->n_rings != kRings && scan->n_rings != kRings + 1) continue;  // one stray point may start a 65th
        for (std::size_t i = 0; i < scan->points.size(); ++i) {
            const glm::dvec4 p(scan->points[i]);
            samples[scan->ring[i]].push_back({std::hypot(p.x, p.y), p.z});
        }
    }
    if (samples[0].empty()) {
        throw DataError(fmt::format("{}: {} rings in file order, expected 64 (HDL-64E, stored ring by ring)", where, most));
    }
    Cones cones;
    for (std::size_t k = 0; k < kRings; ++k) cones[k] = fit_cone(samples[k]);
    fill_gaps(cones, where);
    return cones;
}

void correct_rings(RawScan& scan, const Cones& cones) {
    const std::size_t n = scan.points.size();
    if (scan.n_rings != kRings && scan.n_rings != kRings + 1) {
        for (std::size_t begin = 0; begin < n;) {
            std::size_t end = begin + 1;
            while (end < n && scan.ring[end] == scan.ring[begin]) ++end;
            const auto ring = static_cast<std::uint8_t>(nearest_ring(scan, begin, end, cones));
            std::fill(scan.ring.begin() + static_cast<std::ptrdiff_t>(begin), scan.ring.begin() + static_cast<std::ptrdiff_t>(end), ring);
            begin = end;
        }
    }
    for (std::size_t i = 1; i < n; ++i) {
        const glm::dvec4 p(scan.points[i]);
        if (p.y != 0.0 || scan.ring[i] == scan.ring[i - 1]) continue;
        const Sample s{std::hypot(p.x, p.y), p.z};
        if (std::abs(residual(cones[scan.ring[i - 1]], s)) < std::abs(residual(cones[scan.ring[i]], s))) scan.ring[i] = scan.ring[i - 1];
    }
}

}  // namespace relidar::kitti
