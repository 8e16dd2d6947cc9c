// SPDX-License-Identifier: Apache-2.0
// Detects clouds from which a program has removed points.
#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "read/scans/scan_plan.hpp"

namespace relidar {
namespace {

// Minimum share of rays with a return, if no points were removed. KITTI has 0.92, a
// VLP-16 of TIER IV 0.5.
constexpr double kFewFilled = 0.3;
// Minimum share of regular azimuth steps, if no points were removed. KITTI has 0.98, a
// VLP-16 of TIER IV 0.87. KITTI without a random quarter of the points has 0.77.
constexpr double kFewRegular = 0.78;
constexpr double kMaxRegularStep = 1.5;  // maximum of a regular step, in median steps
// Azimuth steps from point to point that count. Points of one ray have smaller steps, and
// gaps between objects have larger ones.
constexpr double kMinStep_rad = 1e-5, kMaxStep_rad = 0.2;

/// Returns the share of regular azimuth steps between neighbouring points of a ring. A
/// step is regular if it is at most kMaxRegularStep times the median step.
double regular_fraction(const LidarPoints& scan) {
    std::vector<std::pair<std::uint16_t, double>> sorted_points;  // ring and azimuth
    for (std::size_t i = 0; i < scan.size(); ++i)
        sorted_points.emplace_back(scan.ring[i],
                                   std::atan2(double(scan.position_m[i].y), double(scan.position_m[i].x)));
    std::ranges::sort(sorted_points);
    std::vector<double> steps_rad;
    for (std::size_t i = 1; i < sorted_points.size(); ++i) {
        const auto& [ring, azimuth_rad] = sorted_points[i];
        const auto& [ring_before, azimuth_before_rad] = sorted_points[i - 1];
        const double step_rad = azimuth_rad - azimuth_before_rad;
        if (ring == ring_before && step_rad > kMinStep_rad && step_rad < kMaxStep_rad)
            steps_rad.push_back(step_rad);
    }
    if (steps_rad.empty()) return 1.0;
    std::ranges::sort(steps_rad);
    const double most_rad = kMaxRegularStep * steps_rad[steps_rad.size() / 2];
    return double(std::ranges::upper_bound(steps_rad, most_rad) - steps_rad.begin()) /
           double(steps_rad.size());
}

}  // namespace

std::string why_thinned(const std::vector<LidarPoints>& scans, const SpinningSensor& fitted_sensor) {
    const auto fullest = std::ranges::max_element(scans, {}, &LidarPoints::size);
    if (fullest == scans.end()) return "";
    // share of the rays of a full scan that have a point
    const double filled =
        double(fullest->size()) / (double(fitted_sensor.beams.size()) * fitted_sensor.columns);
    if (filled < kFewFilled)
        return fmt::format(
            "the points fill only {:.0f} % of the rays of {} beams and {} columns, so points were probably "
            "removed",
            100.0 * filled, fitted_sensor.beams.size(), fitted_sensor.columns);
    if (const double share = regular_fraction(*fullest); share < kFewRegular)
        return fmt::format(
            "only {:.0f} % of the azimuth steps between points are equal, so points were probably removed",
            100.0 * share);
    return "";
}

}  // namespace relidar
