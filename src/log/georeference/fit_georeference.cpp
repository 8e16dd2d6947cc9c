// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/georeference.hpp>

#include <algorithm>
#include <cmath>
#include <complex>
#include <numeric>

#include <fmt/format.h>

#include <relidar/base/math.hpp>

namespace relidar {
namespace {

// The heading is uncertain if the antenna stays this close to its mean position.
constexpr double kMinSpread_m = 2.0;
constexpr double kMaxResidualShare = 0.2;  // of the spread

glm::dvec3 mean_position(const std::vector<glm::dvec3>& positions_m) {
    const glm::dvec3 sum_m = std::accumulate(positions_m.begin(), positions_m.end(), glm::dvec3(0.0));
    return sum_m / std::max(1.0, double(positions_m.size()));
}

/// Rotation about the vertical axis from the world to the plane.
struct FittedHeading {
    double heading_rad;
    double spread_m;    ///< horizontal standard deviation of the places
    double residual_m;  ///< root of the mean square of the horizontal error
};

/// Fits the heading h that minimises the sum of |p - exp(i h) w|^2. w and p are
/// horizontal positions in world and plane minus their means, as complex numbers. h is
/// the angle of the sum of p * conj(w).
FittedHeading fit_heading(const std::vector<glm::dvec3>& antenna_m, const std::vector<glm::dvec3>& plane_m) {
    const glm::dvec3 world_mean_m = mean_position(antenna_m), plane_mean_m = mean_position(plane_m);
    const auto horizontal = [](const glm::dvec3& v) { return std::complex<double>(v.x, v.y); };
    std::vector<std::complex<double>> w, p;
    for (const glm::dvec3& position_m : antenna_m) w.push_back(horizontal(position_m - world_mean_m));
    for (const glm::dvec3& position_m : plane_m) p.push_back(horizontal(position_m - plane_mean_m));
    std::complex<double> sum = 0.0;
    for (std::size_t i = 0; i < w.size(); ++i) sum += p[i] * std::conj(w[i]);
    const double heading_rad = std::arg(sum);
    double spread = 0.0, residual = 0.0;
    for (std::size_t i = 0; i < w.size(); ++i) {
        spread += std::norm(w[i]);
        residual += std::norm(p[i] - std::polar(1.0, heading_rad) * w[i]);
    }
    const double n = std::max(1.0, double(w.size()));
    return {
        .heading_rad = heading_rad, .spread_m = std::sqrt(spread / n), .residual_m = std::sqrt(residual / n)};
}

}  // namespace

GeoreferenceFit fit_georeference(const std::vector<glm::dvec3>& antenna_m,
                                 const std::vector<GeodeticPosition>& positions) {
    if (positions.empty())
        return {{}, "the place on the earth is unknown: no position is from the time of the path"};
    // Compares positions in a plane that touches the earth at the first one.
    const std::string crs = local_tangent_crs(positions.front());
    const GeoConverter plane(Georeference{.position = positions.front(), .crs = crs});
    std::vector<glm::dvec3> plane_m;
    for (const GeodeticPosition& position : positions) plane_m.push_back(plane.to_dataset(position));
    const FittedHeading fit = fit_heading(antenna_m, plane_m);
    const bool is_clear = fit.spread_m >= kMinSpread_m && fit.residual_m <= kMaxResidualShare * fit.spread_m;
    if (!is_clear)
        return {{},
                fmt::format("the place on the earth is unknown: {} positions extend over {:.2f} m and are "
                            "{:.2f} m from the path",
                            positions.size(), fit.spread_m, fit.residual_m)};
    // The fit maps the mean position in the world to that in the plane.
    return {Georeference{.position = plane.to_geodetic(mean_position(plane_m)),
                         .point_m = mean_position(antenna_m),
                         .crs = crs,
                         .rotation = glm::angleAxis(fit.heading_rad, glm::dvec3(0.0, 0.0, 1.0))},
            fmt::format("the place on the earth is that of {} positions, which are {:.2f} m from the path",
                        positions.size(), fit.residual_m)};
}

}  // namespace relidar
