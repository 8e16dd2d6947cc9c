// SPDX-License-Identifier: Apache-2.0
// Estimates the difference between the real and the nominal azimuth of a spinning LiDAR's
// head for each firing (all lasers at one azimuth). The azimuths differ because motors
// are uneven, firings are grouped in packets, and each sweep begins at a different
// azimuth.
#include <algorithm>
#include <cmath>

#include <relidar/log/log.hpp>

#include "base/median.hpp"

namespace relidar {
namespace {

constexpr std::size_t kMinFiringReturns = 3;  // minimum number of returns of a firing
constexpr double kRounding_rad = 1e-5;        // shifts below this value are rounding errors
// The lasers of a firing rotate together and should have equal azimuth errors. If they
// differ by more than this (median of all rays, in columns), none is estimated.
constexpr double kMaxMismatch_columns = 0.1;

/// Calls visit_ray(ray, firing) for each ray of a scan. A firing is all lasers at one
/// azimuth of the head. Lasers with an azimuth offset are in other columns of the image.
/// `ray`: row * columns + column. `firing`: number of the firing in the sweep, from 0
template <class Visit>
void visit_firings(const SpinningSensor& sensor, const Visit& visit_ray) {
    const auto columns = std::size_t(sensor.columns);
    for (std::size_t row = 0; row < sensor.beams.size(); ++row) {
        // Columns from a ray of this laser to its firing; + columns: never negative.
        const int shift = offset_columns(sensor.beams[row], sensor.columns) % sensor.columns + sensor.columns;
        for (std::size_t column = 0; column < columns; ++column)
            visit_ray(row * columns + column, (column + std::size_t(shift)) % columns);
    }
}

/// Replaces unknown azimuth shifts (NAN) by linear interpolation between the nearest
/// known ones. At both ends of the list, uses the nearest known one.
/// @param azimuth_shifts_rad  at least one is known
void fill_nan_shifts(std::vector<float>& azimuth_shifts_rad) {
    const auto is_known = [](float shift) { return !std::isnan(shift); };
    const auto end = azimuth_shifts_rad.end();
    auto known = std::ranges::find_if(azimuth_shifts_rad, is_known);
    std::fill(azimuth_shifts_rad.begin(), known, *known);
    while (known != end) {
        const auto next_known = std::find_if(known + 1, end, is_known);
        const float step =
            next_known == end ? 0.0f : (*next_known - *known) / static_cast<float>(next_known - known);
        for (auto unknown = known + 1; unknown != next_known; ++unknown) *unknown = *(unknown - 1) + step;
        known = next_known;
    }
}

/// Returns the azimuth of a direction minus that of another one, positive to the left. It
/// is atan2(cross product, dot product) of their horizontal parts.
double azimuth_between_rad(const glm::vec3& from, const glm::vec3& to) {
    return std::atan2(double(from.x) * to.y - double(from.y) * to.x,
                      double(from.x) * to.x + double(from.y) * to.y);
}

}  // namespace

std::vector<float> measure_shifts_rad(const Scan& scan, const SpinningSensor& sensor, const RayTable& table) {
    const RayTable& rays = scan.rays;
    if (table.size() == 0 || std::size_t(rays.rows) != sensor.beams.size() || rays.columns != sensor.columns)
        return {};
    // Azimuth of each returned ray minus its nominal azimuth.
    std::vector<std::vector<float>> shifts_by_firing(std::size_t(sensor.columns));
    visit_firings(sensor, [&](std::size_t ray, std::size_t firing) {
        if (scan.range_m[ray] > 0.0f)
            shifts_by_firing[firing].push_back(
                static_cast<float>(azimuth_between_rad(table.direction[ray], rays.direction[ray])));
    });
    std::vector<float> shift_rad(shifts_by_firing.size(), NAN);  // [firings] NAN: unknown
    std::vector<float> deviations_rad;                           // of rays from their firing
    for (std::size_t firing = 0; firing < shifts_by_firing.size(); ++firing) {
        if (shifts_by_firing[firing].size() < kMinFiringReturns) continue;
        shift_rad[firing] = compute_median(shifts_by_firing[firing]);
        for (const float shift : shifts_by_firing[firing])
            deviations_rad.push_back(std::abs(shift - shift_rad[firing]));
    }
    if (deviations_rad.empty()) return {};  // no firing has enough returns
    const double max_deviation_rad = kMaxMismatch_columns * 2.0 * kPi / sensor.columns;
    const bool rotate_together = compute_median(deviations_rad) <= max_deviation_rad;
    if (!rotate_together) return {};
    fill_nan_shifts(shift_rad);
    const auto is_shifted = [](float shift) { return std::abs(shift) >= kRounding_rad; };
    if (std::ranges::none_of(shift_rad, is_shifted)) return {};
    return shift_rad;
}

RayTable rotate_firings(RayTable nominal, const SpinningSensor& sensor,
                        const std::vector<float>& shifts_rad) {
    if (shifts_rad.empty()) return nominal;
    visit_firings(sensor, [&](std::size_t ray, std::size_t firing) {
        const double cosine = std::cos(double(shifts_rad[firing])),
                     sine = std::sin(double(shifts_rad[firing]));
        for (glm::vec3* v : {&nominal.direction[ray], &nominal.origin[ray]}) {
            *v = {static_cast<float>(cosine * v->x - sine * v->y),
                  static_cast<float>(sine * v->x + cosine * v->y), v->z};
        }
    });
    return nominal;
}

}  // namespace relidar
