// SPDX-License-Identifier: Apache-2.0
// NCore's model has no origins of beams, but beams of some LiDARs start 20 cm beside the
// centre. Seen from the centre, the direction of such a beam depends on the range. With
// the horizontal distance rho of a point and its height z, both
//   z / rho = tan(elevation) + (origin_up / cos(elevation)) / rho   and
//   azimuth - azimuth of the column = azimuth_offset + origin_left / rho
// are lines over 1 / rho, which are fitted to the points of each row.
#include <algorithm>
#include <cmath>

#include "base/median.hpp"
#include "read/datasets/ncore/ncore_scans.hpp"

namespace relidar::ncore {
namespace {

constexpr double kLeastRho_m = 1.0;                        // nearer points have inaccurate directions
constexpr double kMaxSlopeError_m = 0.005;                 // largest standard error of an origin
constexpr std::size_t kFewestReturns = 50;                 // of a row
constexpr int kPasses = 4;                                 // fits without the outliers of the fit before
constexpr double kOutlier = 3.0, kSigmaOfMedian = 1.4826;  // in standard deviations; of normal errors
// Origins are used if they make the angle between rays and points clearly smaller.
constexpr double kClearly = 0.8, kLeastMisfit_rad = 1e-4;

struct Line {
    double at_zero = 0.0, slope = 0.0, slope_error = INFINITY;
};

/// Fits a line by least squares to the points near another line.
Line fit_line(const std::vector<glm::dvec2>& points, const Line& before, double most_off) {
    double n = 0, sx = 0, sy = 0, sxx = 0, sxy = 0, syy = 0;
    for (const glm::dvec2& p : points) {
        if (std::abs(p.y - before.at_zero - before.slope * p.x) > most_off) continue;
        n += 1;
        sx += p.x;
        sy += p.y;
        sxx += p.x * p.x;
        sxy += p.x * p.y;
        syy += p.y * p.y;
    }
    const double spread = sxx - sx * sx / n;
    if (n < double(kFewestReturns) || !(spread > 0.0)) return {};
    const double slope = (sxy - sx * sy / n) / spread, at_zero = (sy - slope * sx) / n;
    const double residual = std::max(0.0, syy - at_zero * sy - slope * sxy);
    return {at_zero, slope, std::sqrt(residual / n / spread)};
}

Line fit_robust_line(const std::vector<glm::dvec2>& points) {
    if (points.size() < kFewestReturns) return {};
    Line line;
    double most_off = INFINITY;
    for (int pass = 0; pass < kPasses; ++pass) {
        line = fit_line(points, line, most_off);
        std::vector<double> off;
        for (const glm::dvec2& p : points) off.push_back(std::abs(p.y - line.at_zero - line.slope * p.x));
        most_off = kOutlier * kSigmaOfMedian * compute_median(std::move(off));
    }
    return line;
}

/// A return in the sensor frame, and the azimuth of its column.
struct RowPoint {
    glm::dvec3 position_m;
    double column_rad;

    double rho_m() const { return std::hypot(position_m.x, position_m.y); }
    double azimuth_rad() const {
        return std::remainder(std::atan2(position_m.y, position_m.x) - column_rad, 2.0 * kPi);
    }
};

/// Returns the angle between the ray of a beam at the azimuth of a column and the point
/// that it hit.
double misfit_rad(const Beam& beam, const RowPoint& point) {
    const BeamRay ray = aim_beam(beam, point.column_rad);
    const glm::dvec3 to_point = glm::normalize(point.position_m - ray.origin_m);
    return 2.0 * std::asin(std::min(1.0, 0.5 * glm::distance(to_point, ray.direction)));
}

double median_misfit(const std::vector<Beam>& beams, const std::vector<std::vector<RowPoint>>& rows) {
    std::vector<double> angles;
    for (std::size_t row = 0; row < rows.size(); ++row)
        for (const RowPoint& point : rows[row]) angles.push_back(misfit_rad(beams[row], point));
    return angles.empty() ? 0.0 : compute_median(std::move(angles));
}

}  // namespace

FittedBeams fit_beam_origins(const std::vector<RayBundle>& bundles, const SpinningModel& model) {
    FittedBeams fitted;
    std::vector<Beam> of_model;
    for (std::size_t row = 0; row < model.elevation_rad.size(); ++row)
        of_model.push_back(
            {.elevation_rad = model.elevation_rad[row], .azimuth_offset_rad = model.offset_rad[row]});
    std::vector<std::vector<RowPoint>> rows(of_model.size());
    for (const RayBundle& bundle : bundles)
        for (std::size_t i = 0; i < bundle.element.size() / 2 && !bundle.range_m.empty(); ++i) {
            const std::size_t row = bundle.element[2 * i], column = bundle.element[2 * i + 1];
            if (row >= rows.size() || column >= model.azimuth_rad.size()) continue;
            const RowPoint point{double(bundle.range_m[0][i]) * bundle.direction[i],
                                 model.azimuth_rad[column]};
            if (point.rho_m() < kLeastRho_m) continue;
            rows[row].push_back(point);
            ++fitted.n_returns;
        }
    fitted.beams = of_model;
    for (std::size_t row = 0; row < rows.size(); ++row) {
        std::vector<glm::dvec2> heights, azimuths;
        for (const RowPoint& point : rows[row]) {
            heights.emplace_back(1.0 / point.rho_m(), point.position_m.z / point.rho_m());
            azimuths.emplace_back(1.0 / point.rho_m(), point.azimuth_rad());
        }
        Beam& beam = fitted.beams[row];
        if (const Line line = fit_robust_line(heights); line.slope_error < kMaxSlopeError_m) {
            beam.elevation_rad = std::atan(line.at_zero);
            beam.origin_up_m = line.slope * std::cos(beam.elevation_rad);
        }
        if (const Line line = fit_robust_line(azimuths); line.slope_error < kMaxSlopeError_m) {
            beam.azimuth_offset_rad = line.at_zero;
            beam.origin_left_m = line.slope;
        }
    }
    fitted.model_misfit_rad = median_misfit(of_model, rows);
    fitted.misfit_rad = median_misfit(fitted.beams, rows);
    fitted.is_better =
        fitted.model_misfit_rad > kLeastMisfit_rad && fitted.misfit_rad < kClearly * fitted.model_misfit_rad;
    if (!fitted.is_better) fitted.beams = of_model;
    return fitted;
}

}  // namespace relidar::ncore
