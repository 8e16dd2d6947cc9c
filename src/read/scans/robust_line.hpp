// SPDX-License-Identifier: Apache-2.0
// Fits a line y = at_zero + slope x to points with outliers, by repeated least squares.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include <glm/glm.hpp>

#include "base/median.hpp"

namespace relidar::read {

struct RobustLine {
    double at_zero = 0.0, slope = 0.0;
    std::size_t n = 0;  ///< number of points in the fit; 0 if the fit is unreliable
    double slope_error = INFINITY;

    double at(double x) const { return at_zero + slope * x; }
    double residual(const glm::dvec2& point) const { return point.y - at_zero - point.x * slope; }
};

struct RobustLineOptions {
    int n_passes = 4;  ///< fits without the outliers of the fit before
    std::size_t min_points = 16;
    double min_spread = 0.0;    ///< sum of the squared deviations of x from its mean
    double min_variance = 0.0;  ///< the same, divided by the number of points
    double min_outlier = 0.0;   ///< points nearer to the line than this are no outliers
};

/// Fits a line to the points that are at most `max_off` above or below another line.
inline RobustLine fit_line(const std::vector<glm::dvec2>& points, const RobustLine& previous, double max_off,
                           const RobustLineOptions& options) {
    double n = 0, sx = 0, sy = 0, sxx = 0, sxy = 0, syy = 0;
    for (const glm::dvec2& p : points) {
        if (std::abs(previous.residual(p)) > max_off) continue;
        n += 1;
        sx += p.x;
        sy += p.y;
        sxx += p.x * p.x;
        sxy += p.x * p.y;
        syy += p.y * p.y;
    }
    const double spread = n * sxx - sx * sx;  // n times the sum of squared deviations of x
    if (n < double(options.min_points) || !(spread > 0.0) || spread < options.min_spread * n ||
        spread < options.min_variance * n * n)
        return {};
    const double slope = (n * sxy - sx * sy) / spread, at_zero = (sy - slope * sx) / n;
    const double squares = std::max(0.0, syy - at_zero * sy - slope * sxy);
    return {at_zero, slope, std::size_t(n), std::sqrt(squares / spread)};
}

/// standard deviation of normal errors, divided by their median absolute value
inline constexpr double kMadToSigma = 1.4826;

/// Starts with all points. Then repeats the fit without points that are more than three
/// standard deviations away.
inline RobustLine fit_robust_line(const std::vector<glm::dvec2>& points, const RobustLineOptions& options) {
    RobustLine line = fit_line(points, {}, INFINITY, options);
    for (int pass = 0; pass < options.n_passes && line.n > 0; ++pass) {
        std::vector<double> errors;
        for (const glm::dvec2& p : points) errors.push_back(std::abs(line.residual(p)));
        const double sigma = kMadToSigma * compute_median(std::move(errors));
        line = fit_line(points, line, std::max(3.0 * sigma, options.min_outlier), options);
    }
    return line;
}

}  // namespace relidar::read
