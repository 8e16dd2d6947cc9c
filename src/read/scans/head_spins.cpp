// SPDX-License-Identifier: Apache-2.0
// Checks whether points come from a spinning LiDAR. Other LiDARs scan a window or a
// rosette pattern.
#include <algorithm>
#include <array>
#include <cmath>

#include <fmt/format.h>

#include "read/scans/scan_plan.hpp"

namespace relidar {
namespace {

// Maximum difference between the 90th and the 10th percentile of the elevations of a
// ring, for the farther half of its points.
constexpr double kMostSpread_rad = 1.5 * kPi / 180.0;
// In a narrower range without points, the vehicle may block the view.
constexpr double kLeastGap_rad = kPi / 3.0;
// Relative difference between the period of rotation and the time between scans.
constexpr double kOtherPeriod = 0.2;
constexpr std::size_t kFewestPoints = 50;

double elevation_rad_of(const glm::vec3& point) {
    return std::atan2(double(point.z), std::hypot(double(point.x), double(point.y)));
}

/// Returns the median over all rings of the spread of elevations (10th to 90th
/// percentile). Uses only the farther half of each ring, because beams start beside the
/// origin.
double ring_spread(const LidarPoints& scan) {
    std::vector<std::vector<std::pair<float, double>>> rings;  // range and elevation
    for (std::size_t i = 0; i < scan.size(); ++i) {
        if (scan.ring[i] >= rings.size()) rings.resize(std::size_t(scan.ring[i]) + 1);
        rings[scan.ring[i]].emplace_back(glm::length(scan.position_m[i]),
                                         elevation_rad_of(scan.position_m[i]));
    }
    std::vector<double> spreads;
    for (auto& ring : rings) {
        if (ring.size() < kFewestPoints) continue;
        std::ranges::sort(ring);
        std::vector<double> far;
        for (std::size_t k = ring.size() / 2; k < ring.size(); ++k) far.push_back(ring[k].second);
        std::ranges::sort(far);
        spreads.push_back(far[far.size() * 9 / 10] - far[far.size() / 10]);
    }
    if (spreads.empty()) return 0.0;
    std::ranges::sort(spreads);
    return spreads[spreads.size() / 2];
}

/// Returns the widest azimuth range in which no scan has a point.
double widest_gap_rad(const std::vector<LidarPoints>& scans) {
    constexpr std::size_t kAzimuthBins = 360;
    std::array<bool, kAzimuthBins> is_bin_occupied{};
    for (const LidarPoints& scan : scans)
        for (const glm::vec3& p : scan.position_m)
            is_bin_occupied[std::size_t((std::atan2(double(p.y), double(p.x)) / (2.0 * kPi) + 0.5) *
                                        kAzimuthBins) %
                            kAzimuthBins] = true;
    std::size_t widest = 0, run = 0;
    // Counts every bin twice, because a gap may contain the start of the circle.
    for (std::size_t b = 0; b < 2 * kAzimuthBins; ++b) {
        run = is_bin_occupied[b % kAzimuthBins] ? 0 : run + 1;
        widest = std::max(widest, std::min(run, kAzimuthBins));
    }
    return 2.0 * kPi * double(widest) / double(kAzimuthBins);
}

}  // namespace

std::string why_not_spinning(const std::vector<LidarPoints>& scans, const SpinningSensor& fitted_sensor,
                             double frame_interval_s) {
    const auto fullest = std::ranges::max_element(scans, {}, &LidarPoints::size);
    if (fullest == scans.end()) return "";
    if (const double spread = ring_spread(*fullest); spread > kMostSpread_rad)
        return fmt::format(
            "the points of one ring differ in elevation by {:.1f} degrees; the usual causes are merged "
            "clouds of several LiDARs, wrong rings, or another frame",
            spread * 180.0 / kPi);
    const double gap = widest_gap_rad(scans);
    // A gap alone can be a limited field of view. It is an error only if the point
    // times also show another period than one revolution per scan.
    if (gap < kLeastGap_rad || fullest->time_offset_s.empty() ||
        std::abs(fitted_sensor.period_s - frame_interval_s) < kOtherPeriod * frame_interval_s)
        return "";
    return fmt::format(
        "all points are within a sector of {:.0f} degrees of azimuth, and the times of the points show a "
        "revolution of {:.3f} s, but a revolution should take {:.3f} s",
        360.0 - gap * 180.0 / kPi, fitted_sensor.period_s, frame_interval_s);
}

}  // namespace relidar
