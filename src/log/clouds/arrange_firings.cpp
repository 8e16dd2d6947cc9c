// SPDX-License-Identifier: Apache-2.0
#include "log/clouds/arrange_firings.hpp"

#include <algorithm>
#include <cmath>
#include <complex>

#include "log/sensor/beam_geometry.hpp"

namespace relidar {
namespace {

// The head azimuth is rounded to this many steps per revolution (0.0055 degrees per
// step).
constexpr int kTicks = 1 << 16;
// If more firings than this are missing at the end of a revolution, the sensor fired but
// measured no returns there.
constexpr int kMostMissing = 8;

/// Returns the azimuth of the LiDAR's head for each firing. Firings without points are
/// interpolated between their neighbours.
std::map<int, double> compute_head_azimuths(const Points& points, const std::vector<int>& numbers,
                                            const SpinningSensor& sensor, double step_rad) {
    const std::vector<BeamGeometry> beams = make_beam_geometries(sensor.beams);
    // The phase of each sum is the mean deviation of a firing's points from a constant
    // rotation.
    std::map<int, std::complex<double>> sums;
    for (std::size_t i = 0; i < points.size(); ++i)
        sums[numbers[i]] +=
            std::polar(1.0, beams[points.ring[i]].compute_head_azimuth(glm::dvec3(points.position_m[i])) -
                                numbers[i] * step_rad);
    std::map<int, double> heads;
    for (auto at = sums.begin(); at != sums.end(); ++at) {
        const auto next = std::next(at) == sums.end() ? at : std::next(at);
        const double uneven = std::arg(at->second),
                     change = std::remainder(std::arg(next->second) - uneven, 2.0 * kPi);
        const int first = at->first, gap = std::max(next->first - first, 1);
        for (int n = first; n < first + gap; ++n)
            heads[n] = std::remainder(uneven + change * (n - first) / gap + n * step_rad, 2.0 * kPi);
    }
    return heads;
}

/// Adds firings without returns at the end of a revolution. The head is assumed to rotate
/// at a constant rate until the circle or the image is full.
/// @param columns  number of columns of the image; 0 if unknown
void add_firings_to_turn_end(std::map<int, double>& heads, int columns, double step_rad) {
    const int full = int(2.0 * kPi / std::abs(step_rad));
    const int n_missing = (columns > 0 ? std::min(columns, full) : full) - int(heads.size());
    const auto [last, head] = *heads.rbegin();
    for (int k = 1; n_missing > kMostMissing && k <= n_missing; ++k)
        heads[last + k] = std::remainder(head + k * step_rad, 2.0 * kPi);
}

}  // namespace

Sweep arrange_firings(Points& points, const std::vector<int>& numbers, const SpinningSensor& sensor,
                      double step_rad) {
    std::map<int, double> heads = compute_head_azimuths(points, numbers, sensor, step_rad);
    add_firings_to_turn_end(heads, sensor.columns, step_rad);
    return sort_firings(points, numbers, heads);
}

Sweep sort_firings(Points& points, const std::vector<int>& numbers, const std::map<int, double>& head_rad) {
    std::vector<std::pair<double, int>> by_azimuth;
    for (const auto& [number, head] : head_rad) by_azimuth.emplace_back(-head, number);
    std::sort(by_azimuth.begin(), by_azimuth.end());
    Sweep sweep{{kTicks, 0.0}, {}};
    std::map<int, std::uint32_t> place;
    for (const auto& [azimuth, number] : by_azimuth) {
        place[number] = std::uint32_t(sweep.firings.size());
        sweep.firings.push_back(sweep.lattice.tick(-azimuth));
    }
    points.firing.clear();
    for (const int number : numbers) points.firing.push_back(place[number]);
    return sweep;
}

}  // namespace relidar
