// SPDX-License-Identifier: Apache-2.0
#include "log/readers/bag/packets/fired_points.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace relidar::packets {
namespace {

// If more consecutive columns than this have no measurement, their rays become rays
// without a return. In a shorter gap, the scan repeats neighbouring columns.
constexpr std::size_t kMostUnmeasured = 8;

/// Finds long runs of columns without measurements and sets `column_has_fired` to true.
/// Their rays then become rays without a return. Skips columns whose packets were lost.
void mark_long_gaps_without_returns_as_fired(std::vector<bool>& column_has_fired,
                                             const std::vector<bool>& column_is_enabled,
                                             const std::vector<bool>& column_is_lost) {
    std::size_t run = 0;
    for (std::size_t c = 0; c <= column_is_enabled.size(); ++c) {
        if (c < column_is_enabled.size() && column_is_enabled[c] && !column_has_fired[c] &&
            !column_is_lost[c]) {
            ++run;
            continue;
        }
        for (std::size_t k = 1; run > kMostUnmeasured && k <= run; ++k) column_has_fired[c - k] = true;
        run = 0;
    }
}

}  // namespace

void add_points_of_firing(RevolutionPoints& revolution_points, const FiringInstant& firing,
                          const std::array<DecodedReturn, 2>* returns_of_each_ring,
                          const std::vector<BeamRayGenerator>& beams,
                          const std::vector<double>& beam_offsets_us) {
    LidarPoints& points = revolution_points.points;
    revolution_points.head_rad.try_emplace(firing.number,
                                           -std::remainder(firing.azimuth_deg, 360.0) * kPi / 180.0);
    for (std::size_t ring = 0; ring < beams.size(); ++ring) {
        const double head_deg = firing.azimuth_deg + firing.ahead_deg_us * beam_offsets_us[ring];
        const BeamRay ray = beams[ring].compute_ray(-head_deg * kPi / 180.0);
        const auto add = [&](const DecodedReturn& echo, std::uint8_t number) {
            points.position_m.emplace_back(ray.origin_m + ray.direction * double(echo.range_m));
            points.intensity.push_back(float(double(echo.intensity) / firing.brightness));
            points.ring.push_back(std::uint16_t(ring));
            points.time_offset_s.push_back(float(firing.time_s + 1e-6 * beam_offsets_us[ring]));
            points.return_number.push_back(number);
            revolution_points.numbers.push_back(firing.number);
        };
        DecodedReturn first = returns_of_each_ring[ring][0],
                      other = returns_of_each_ring[ring][1];  // two returns may be identical
        if (other.range_m == first.range_m) other.range_m = 0.0f;
        if (first.range_m == 0.0f || (other.range_m != 0.0f && other.intensity > first.intensity))
            std::swap(first, other);
        if (first.range_m != 0.0f) add(first, 1);
        if (other.range_m != 0.0f) add(other, 2);
    }
}

Scan make_scan_of_fixed_azimuth_sensor(RevolutionPoints& revolution_points,
                                       const std::vector<bool>& column_is_enabled,
                                       const std::vector<bool>& column_is_lost, SpinningSensor sensor) {
    std::vector<bool> has_fired(column_is_enabled.size(), false);
    for (const auto& [column, head_rad] : revolution_points.head_rad) has_fired[std::size_t(column)] = true;
    mark_long_gaps_without_returns_as_fired(has_fired, column_is_enabled, column_is_lost);
    SweepFirings sweep{{int(has_fired.size()), kPi}, {}};
    std::vector<std::uint32_t> firing_index_of_column(has_fired.size());
    for (std::size_t c = 0; c < has_fired.size(); ++c) {
        firing_index_of_column[c] = std::uint32_t(sweep.firings.size());
        if (has_fired[c]) sweep.firings.push_back(int((has_fired.size() - c) % has_fired.size()));
    }
    for (const int column : revolution_points.numbers)
        revolution_points.points.firing.push_back(firing_index_of_column[std::size_t(column)]);
    // If packets were lost, the scan has only the columns that were received.
    const bool has_gaps = std::ranges::count(column_is_lost, true) > 0;
    sensor.columns =
        std::max(has_gaps ? 0 : int(std::ranges::count(column_is_enabled, true)), int(sweep.firings.size()));
    return assign_points_to_rays_of_spinning_scan(revolution_points.points, sensor, sweep);
}

}  // namespace relidar::packets
