// SPDX-License-Identifier: Apache-2.0
// Beams do not start at the origin of the sensor, because the lenses are above or below
// it. So the elevation seen from the origin depends on the range, but the angle of the
// cone of a beam does not.
#include "read/datasets/kitti/hdl64_rings.hpp"

#include <algorithm>
#include <cmath>
#include <span>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>

#include "base/fail.hpp"
#include "base/median.hpp"
#include "read/scans/robust_line.hpp"

namespace relidar::kitti {
namespace {

// Coordinates have rounding errors of 0.3 mm, so the slope is inaccurate if all points
// have similar distances rho. If the sum of (rho - mean of rho)^2 is at least 36 m^2, the
// slope error is below 5e-5.
constexpr read::RobustLineOptions kConeFit{
    .n_passes = 4, .min_points = 16, .min_spread = 36.0, .min_outlier = 1e-3};

/// Points of each beam: the distance from the spin axis, and the height.
using ConePoints = std::array<std::vector<glm::dvec2>, kRings>;

glm::dvec2 to_cone_point(const glm::vec3& point) {
    const glm::dvec3 p(point);
    return {std::hypot(p.x, p.y), p.z};
}

/// Returns the distance of a point above or below a cone.
double height_error_m(const read::RingCone& cone, const glm::vec3& point) {
    const glm::dvec2 p = to_cone_point(point);
    return std::abs(p.y - cone.z0_m - p.x * cone.slope);
}

/// Estimates the cone z = z0 + slope * rho of a beam to which none could be fitted.
/// @param fitted  beams of the same block with a cone, ascending, at least two
/// @param height_of_slope  z0 of the beams of the block, a linear function of the slope
/// @param points  distance rho and height z of the points of the beam; may be empty
read::RingCone estimate_cone(const BeamCones& cones, std::size_t beam, const std::vector<std::size_t>& fitted,
                             const read::RobustLine& height_of_slope, const std::vector<glm::dvec2>& points) {
    // Interpolates the slope between the nearest fitted beams a < b on both sides. At an
    // end of the block, extrapolates from the first or the last two of them.
    const auto upper = std::lower_bound(fitted.begin() + 1, fitted.end() - 1, beam);
    const std::size_t a = *(upper - 1), b = *upper;
    const double fraction = (double(beam) - double(a)) / double(b - a);
    double slope = cones[a].slope + (cones[b].slope - cones[a].slope) * fraction;
    // The median over enough points is better: (z - z0) / rho. But z0 depends on the
    // slope, so each pass uses the slope of the pass before.
    constexpr int kPasses = 3;
    constexpr double kMinRho_m = 0.1;  // prevents a division by 0
    for (int pass = 0; pass < kPasses && points.size() >= kConeFit.min_points; ++pass) {
        const double z0_m = height_of_slope.at(slope);
        std::vector<double> slopes;
        for (const glm::dvec2& p : points) slopes.push_back((p.y - z0_m) / std::max(p.x, kMinRho_m));
        slope = compute_median(std::move(slopes));
    }
    return {.z0_m = height_of_slope.at(slope), .slope = slope};
}

/// Estimates the cones z = z0 + slope * rho that could not be fitted, whose slope is NaN.
/// Each half of the 64 beams is one laser block. In a block, z0 is a linear function of
/// the slope.
void fill_missing_cones(BeamCones& cones, const ConePoints& points, const std::string& where) {
    constexpr std::size_t kBlock = kRings / 2;
    for (const std::size_t first : {std::size_t{0}, kBlock}) {  // first beam of a block
        std::vector<std::size_t> fitted, missing;
        std::vector<glm::dvec2> slopes_and_heights;
        for (std::size_t k = first; k < first + kBlock; ++k) {
            (std::isnan(cones[k].slope) ? missing : fitted).push_back(k);
            if (!std::isnan(cones[k].slope)) slopes_and_heights.emplace_back(cones[k].slope, cones[k].z0_m);
        }
        const read::RobustLine height_of_slope =
            read::fit_line(slopes_and_heights, {}, INFINITY, {.min_points = 2});
        if (height_of_slope.n == 0)
            fail(
                "{}: fewer than two beams of a block of 32 beams have enough returns, expected a log of an "
                "HDL-64E",
                where);
        for (const std::size_t k : missing)
            cones[k] = estimate_cone(cones, k, fitted, height_of_slope, points[k]);
    }
}

/// Returns the beam whose cone has the smallest median distance from points of one beam.
std::size_t find_nearest_cone(std::span<const glm::vec3> points, const BeamCones& cones) {
    // About 32 points are enough.
    const std::size_t step = std::max<std::size_t>(points.size() / 32, 1);
    std::size_t best = 0;
    double least_m = INFINITY;
    for (std::size_t k = 0; k < kRings; ++k) {
        std::vector<double> errors_m;
        for (std::size_t i = 0; i < points.size(); i += step)
            errors_m.push_back(height_error_m(cones[k], points[i]));
        if (const double median_m = compute_median(std::move(errors_m)); median_m < least_m) {
            least_m = median_m;
            best = k;
        }
    }
    return best;
}

/// Gives consecutive points with the same ring number, which are from one beam, the
/// number of the beam with the nearest cone.
void match_rings_to_cones(LidarPoints& points, const BeamCones& cones) {
    std::vector<std::uint16_t>& ring = points.ring;
    for (auto begin = ring.begin(); begin != ring.end();) {
        const auto end = std::find_if(begin, ring.end(), [&](std::uint16_t r) { return r != *begin; });
        const std::span ring_points(&points.position_m[std::size_t(begin - ring.begin())],
                                    std::size_t(end - begin));
        std::fill(begin, end, std::uint16_t(find_nearest_cone(ring_points, cones)));
        begin = end;
    }
}

}  // namespace

RingScan split_rings(LidarPoints points) {
    RingScan scan{.points = std::move(points)};
    int ring = 0;
    bool fourth = false;  // true if the previous point is in the 4th quadrant (x >= 0, y < 0)
    for (const glm::vec3& p : scan.points.position_m) {
        if (fourth && p.x > 0.0f && p.y >= 0.0f) ++ring;
        fourth = p.x >= 0.0f && p.y < 0.0f;
        scan.points.ring.push_back(std::uint16_t(std::min(ring, 255)));
    }
    scan.n_rings = ring + 1;
    return scan;
}

BeamCones fit_ring_cones(const std::vector<const RingScan*>& scans, const std::string& where) {
    ConePoints points;
    int most = 0;
    for (const RingScan* scan : scans) {
        most = std::max(most, scan->n_rings);
        if (!scan->is_complete()) continue;
        for (std::size_t i = 0; i < scan->points.size(); ++i)
            // A complete scan can have a stray point in a 65th ring.
            points[std::min<int>(scan->points.ring[i], kRings - 1)].push_back(
                to_cone_point(scan->points.position_m[i]));
    }
    // No scan is complete, because a complete scan has points in ring 0.
    if (points[0].empty())
        fail(
            "{}: found {} rings in the order of the file, expected 64 rings of an HDL-64E, stored one after "
            "another",
            where, most);
    BeamCones cones;
    for (std::size_t k = 0; k < kRings; ++k) {
        const read::RobustLine line = read::fit_robust_line(points[k], kConeFit);
        cones[k] = {.z0_m = line.at_zero, .slope = line.n > 0 ? line.slope : NAN};
    }
    fill_missing_cones(cones, points, where);
    return cones;
}

void correct_rings(RingScan& scan, const BeamCones& cones) {
    if (scan.n_rings != kRings) match_rings_to_cones(scan.points, cones);
    const std::vector<glm::vec3>& points = scan.points.position_m;
    std::vector<std::uint16_t>& ring = scan.points.ring;
    // If the first point of a ring has azimuth 0, it can be the last of the ring before.
    for (std::size_t i = 1; i < points.size(); ++i) {
        if (points[i].y != 0.0f || ring[i] == ring[i - 1]) continue;
        if (height_error_m(cones[ring[i - 1]], points[i]) < height_error_m(cones[ring[i]], points[i]))
            ring[i] = ring[i - 1];
    }
}

}  // namespace relidar::kitti
