// SPDX-License-Identifier: Apache-2.0
#include "log/readers/bag/packets/fired_points.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace relidar::packets {
namespace {

// If more consecutive columns than this have no measurement, the sensor did not measure
// in this sector.
constexpr std::size_t kMostUnmeasured = 8;

/// Marks long runs of unmeasured columns as fired, so that their rays become dropped
/// rays. Does not mark columns of lost packets.
void mark_unmeasured_columns(std::vector<bool>& has_fired, const std::vector<bool>& fires,
                             const std::vector<bool>& is_lost) {
    std::size_t run = 0;
    for (std::size_t c = 0; c <= fires.size(); ++c) {
        if (c < fires.size() && fires[c] && !has_fired[c] && !is_lost[c]) {
            ++run;
            continue;
        }
        for (std::size_t k = 1; run > kMostUnmeasured && k <= run; ++k) has_fired[c - k] = true;
        run = 0;
    }
}

}  // namespace

void add_firing(FiredPoints& fired, const FiringPlace& place, const std::array<Echo, 2>* echoes,
                const std::vector<BeamGeometry>& beams, const std::vector<double>& offset_us) {
    Points& points = fired.points;
    fired.head_rad.try_emplace(place.number, -std::remainder(place.azimuth_deg, 360.0) * kPi / 180.0);
    for (std::size_t ring = 0; ring < beams.size(); ++ring) {
        const double head_deg = place.azimuth_deg + place.ahead_deg_us * offset_us[ring];
        const BeamRay ray = beams[ring].ray(-head_deg * kPi / 180.0);
        const auto add = [&](const Echo& echo, std::uint8_t number) {
            points.position_m.emplace_back(ray.origin_m + ray.direction * double(echo.range_m));
            points.intensity.push_back(float(double(echo.intensity) / place.brightness));
            points.ring.push_back(std::uint16_t(ring));
            points.time_offset_s.push_back(float(place.time_s + 1e-6 * offset_us[ring]));
            points.return_number.push_back(number);
            fired.numbers.push_back(place.number);
        };
        Echo first = echoes[ring][0], other = echoes[ring][1];  // two returns may be identical
        if (other.range_m == first.range_m) other.range_m = 0.0f;
        if (first.range_m == 0.0f || (other.range_m != 0.0f && other.intensity > first.intensity))
            std::swap(first, other);
        if (first.range_m != 0.0f) add(first, 1);
        if (other.range_m != 0.0f) add(other, 2);
    }
}

Scan make_fired_scan(FiredPoints& fired, const std::vector<bool>& fires, const std::vector<bool>& is_lost,
                     SpinningSensor sensor) {
    std::vector<bool> has_fired(fires.size(), false);
    for (const auto& [column, head_rad] : fired.head_rad) has_fired[std::size_t(column)] = true;
    mark_unmeasured_columns(has_fired, fires, is_lost);
    Sweep sweep{{int(has_fired.size()), kPi}, {}};
    std::vector<std::uint32_t> place(has_fired.size());
    for (std::size_t c = 0; c < has_fired.size(); ++c) {
        place[c] = std::uint32_t(sweep.firings.size());
        if (has_fired[c]) sweep.firings.push_back(int((has_fired.size() - c) % has_fired.size()));
    }
    for (const int column : fired.numbers) fired.points.firing.push_back(place[std::size_t(column)]);
    // After packet loss, the scan has only the columns that were received.
    const bool has_gaps = std::ranges::count(is_lost, true) > 0;
    sensor.columns = std::max(has_gaps ? 0 : int(std::ranges::count(fires, true)), int(sweep.firings.size()));
    return make_spinning_scan(fired.points, sensor, sweep);
}

}  // namespace relidar::packets
