// SPDX-License-Identifier: Apache-2.0
// Assigns the points of an HDL-64E to rings by their order in the file. Fits a cone z =
// z0 + rho * tan(elevation) to each ring by least squares. Beams do not start at the
// origin of the sensor, because the lenses are above or below it. So the elevation seen
// from the origin depends on the range, but the angle of the cone does not.
#include "read/datasets/kitti/hdl64_rings.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>

#include "base/fail.hpp"
#include "base/median.hpp"

namespace relidar::kitti {
namespace {

// Coordinates have rounding errors of 0.3 mm, so the slope is inaccurate if all points
// have similar distances rho. If the sum of (rho - mean of rho)^2 is at least 36 m^2, the
// slope error is below 5e-5.
constexpr read::RobustLineOptions kConeFit{
    .n_passes = 4, .min_points = 16, .min_spread = 36.0, .min_outlier = 1e-3};

/// Returns the distance of a point from the spin axis, and its height.
glm::dvec2 to_cone_point(const glm::vec4& point) {
    const glm::dvec4 p(point);
    return {std::hypot(p.x, p.y), p.z};
}

/// Heights at which the 32 beams of a laser block cross the spin axis: z0 = mean_z0 +
/// slope * (tan_elevation - mean_tan). The means are over the fitted beams.
struct HeightFit {
    double mean_tan = 0.0, mean_z0 = 0.0, slope = 0.0;
    double height_at_m(double tan_elevation) const { return mean_z0 + slope * (tan_elevation - mean_tan); }
};

/// Fits a line to the heights of the beams in `fitted_rings`, which belong to one laser
/// block. The height is a linear function of tan(elevation).
HeightFit fit_heights(const BeamCones& cones, const std::vector<std::size_t>& fitted_rings) {
    HeightFit line;
    double sum_tt = 0.0, sum_tz = 0.0;
    for (const std::size_t k : fitted_rings) {
        line.mean_tan += cones[k].slope / double(fitted_rings.size());
        line.mean_z0 += cones[k].at_zero / double(fitted_rings.size());
    }
    for (const std::size_t k : fitted_rings) {
        const double tan_deviation = cones[k].slope - line.mean_tan;
        sum_tt += tan_deviation * tan_deviation;
        sum_tz += tan_deviation * (cones[k].at_zero - line.mean_z0);
    }
    line.slope = sum_tz / std::max(sum_tt, 1e-12);
    return line;
}

/// Returns the median of tan(elevation) over the points of one beam. Used if all points
/// have similar distances, so that no line can be fitted to them. `fit` gives the height
/// of the beam; it was fitted to other beams of the block.
/// @param tan_elevation  first guess, on which the height depends; improved in 3 passes
double tan_elevation_at(const std::vector<glm::dvec2>& samples, const HeightFit& fit, double tan_elevation) {
    std::vector<double> slopes(samples.size());
    for (int pass = 0; pass < 3; ++pass) {
        for (std::size_t i = 0; i < samples.size(); ++i)
            slopes[i] = (samples[i].y - fit.height_at_m(tan_elevation)) / std::max(samples[i].x, 0.1);
        tan_elevation = compute_median(slopes);
    }
    return tan_elevation;
}

/// Estimates height and elevation of each beam that could not be fitted. Uses the fitted
/// beams in the same half of the 64 beams, because each half is one laser block.
void fill_missing_cones(BeamCones& cones, const std::array<std::vector<glm::dvec2>, kRings>& samples_of_rings,
                        const std::string& where) {
    for (std::size_t first : {std::size_t{0}, std::size_t{kRings / 2}}) {  // first beam of a block
        std::vector<std::size_t> good;
        for (std::size_t k = first; k < first + kRings / 2; ++k)
            if (cones[k].n > 0) good.push_back(k);
        if (good.size() < 2)
            throw DataError(where +
                            ": fewer than two beams of a block of 32 beams have enough returns, expected a "
                            "log of an HDL-64E");
        const HeightFit line = fit_heights(cones, good);
        for (std::size_t k = first; k < first + kRings / 2; ++k) {
            if (cones[k].n > 0) continue;
            // Interpolates tan(elevation) between the neighbouring fitted beams a and b,
            // or extrapolates at the ends of the block.
            const auto next = std::lower_bound(good.begin() + 1, good.end() - 1, k);
            const std::size_t a = next[-1], b = *next;
            const double along = (double(k) - double(a)) / double(b - a);
            cones[k].slope = cones[a].slope + (cones[b].slope - cones[a].slope) * along;
            if (samples_of_rings[k].size() >= 16)
                cones[k].slope = tan_elevation_at(samples_of_rings[k], line, cones[k].slope);
            cones[k].at_zero = line.height_at_m(cones[k].slope);
        }
    }
}

/// Returns the ring of a group of consecutive points. Chooses the cone with the smallest
/// median distance from the points.
int find_nearest_ring(const RingScan& scan, std::size_t begin, std::size_t end, const BeamCones& cones) {
    const std::size_t step = std::max<std::size_t>((end - begin) / 32, 1);
    int best = 0;
    double least = INFINITY;
    for (int k = 0; k < kRings; ++k) {
        std::vector<double> error;
        for (std::size_t i = begin; i < end; i += step)
            error.push_back(std::abs(cones[std::size_t(k)].residual(to_cone_point(scan.points[i]))));
        if (const double middle = compute_median(std::move(error)); middle < least) {
            least = middle;
            best = k;
        }
    }
    return best;
}

}  // namespace

RingScan split_rings(std::vector<glm::vec4> points) {
    RingScan scan;
    scan.points = std::move(points);
    scan.ring.resize(scan.points.size());
    int ring = 0;
    bool fourth = false;  // true if the previous point is in the 4th quadrant (x >= 0, y < 0)
    for (std::size_t i = 0; i < scan.points.size(); ++i) {
        const glm::vec4& p = scan.points[i];
        if (fourth && p.x > 0.0f && p.y >= 0.0f) ++ring;
        fourth = p.x >= 0.0f && p.y < 0.0f;
        scan.ring[i] = std::uint8_t(std::min(ring, 255));
    }
    scan.n_rings = ring + 1;
    return scan;
}

BeamCones fit_ring_cones(const std::vector<const RingScan*>& scans, const std::string& where) {
    std::array<std::vector<glm::dvec2>, kRings> samples;
    int most = 0;
    for (const RingScan* scan : scans) {
        most = std::max(most, scan->n_rings);
        // A stray point can look like the start of a 65th ring.
        if (scan->n_rings != kRings && scan->n_rings != kRings + 1) continue;
        for (std::size_t i = 0; i < scan->points.size(); ++i)
            samples[std::min<int>(scan->ring[i], kRings - 1)].push_back(to_cone_point(scan->points[i]));
    }
    // No scan is complete, because a complete scan has points in ring 0.
    if (samples[0].empty())
        fail(
            "{}: found {} rings in the order of the file, expected 64 rings of an HDL-64E, stored one after "
            "another",
            where, most);
    BeamCones cones;
    for (std::size_t k = 0; k < kRings; ++k) cones[k] = fit_robust_line(samples[k], kConeFit);
    fill_missing_cones(cones, samples, where);
    return cones;
}

void correct_rings(RingScan& scan, const BeamCones& cones) {
    const std::size_t n = scan.points.size();
    // After a wrong count of rings, each group gets the ring of the nearest cone.
    if (scan.n_rings != kRings)
        for (std::size_t begin = 0; begin < n;) {
            std::size_t end = begin + 1;
            while (end < n && scan.ring[end] == scan.ring[begin]) ++end;
            const auto ring = std::uint8_t(find_nearest_ring(scan, begin, end, cones));
            std::fill(scan.ring.begin() + static_cast<std::ptrdiff_t>(begin),
                      scan.ring.begin() + static_cast<std::ptrdiff_t>(end), ring);
            begin = end;
        }
    for (std::size_t i = 1; i < n; ++i) {
        // Only a point at azimuth 0 can belong to the end of the previous ring.
        if (scan.points[i].y != 0.0f || scan.ring[i] == scan.ring[i - 1]) continue;
        const glm::dvec2 point = to_cone_point(scan.points[i]);
        if (std::abs(cones[scan.ring[i - 1]].residual(point)) < std::abs(cones[scan.ring[i]].residual(point)))
            scan.ring[i] = scan.ring[i - 1];
    }
}

}  // namespace relidar::kitti
