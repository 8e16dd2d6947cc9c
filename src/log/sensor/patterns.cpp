// SPDX-License-Identifier: Apache-2.0
// Ray tables of LiDARs that do not spin, and of a sensor whatever makes its rays.
#include <relidar/log/sensor.hpp>

#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>

namespace relidar {
namespace {

void check_count(const std::string& name, double n_rays) {
    if (!(n_rays >= 1.0 && n_rays <= double(kMaxRays)))
        throw UsageError(fmt::format("sensor '{}': makes {} rays, expected 1 to {}", name, n_rays, kMaxRays));
}

void check_finite(const std::string& name, double sum, double period_s) {
    if (!std::isfinite(sum))
        throw UsageError(fmt::format("sensor '{}': an angle or rate is not finite, expected numbers", name));
    if (!(period_s > 0.0) || !std::isfinite(period_s))
        throw UsageError(
            fmt::format("sensor '{}': has a period of {} s, expected a positive number", name, period_s));
}

/// The n-th of so many values that are evenly spaced from first to last.
double between(double first, double last, int i, int n) {
    return n > 1 ? first + (last - first) * i / (n - 1) : 0.5 * (first + last);
}

void add_ray(RayTable& rays, const glm::dvec3& direction, double time_s, int channel) {
    rays.origin.emplace_back(0.0f);
    rays.direction.emplace_back(direction);
    rays.time_offset_s.push_back(static_cast<float>(time_s));
    rays.channel.push_back(static_cast<std::uint16_t>(channel));
}

}  // namespace

RayTable make_rays(const Rosette& r, double time_s) {
    check_count(r.name, r.n_rays);
    check_finite(r.name, r.deflection_rad + r.first_hz + r.second_hz + r.divergence_rad + time_s, r.period_s);
    RayTable rays;
    rays.rows = 1;
    rays.columns = r.n_rays;
    rays.divergence_rad = static_cast<float>(r.divergence_rad);
    for (int i = 0; i < r.n_rays; ++i) {
        const double offset_s = ((i + 0.5) / r.n_rays - 0.5) * r.period_s;
        const double first = 2.0 * kPi * std::fmod(r.first_hz * (time_s + offset_s), 1.0);
        const double second = 2.0 * kPi * std::fmod(r.second_hz * (time_s + offset_s), 1.0);
        const double left = r.deflection_rad * (std::cos(first) + std::cos(second));
        const double up = r.deflection_rad * (std::sin(first) + std::sin(second));
        const double bent = std::hypot(left, up), share = bent > 0.0 ? std::sin(bent) / bent : 1.0;
        add_ray(rays, {std::cos(bent), left * share, up * share}, offset_s, 0);
    }
    return rays;
}

RayTable make_rays(const ScanningWindow& w) {
    check_count(w.name, double(w.rows) * double(w.columns));
    check_finite(w.name, w.left_rad + w.right_rad + w.top_rad + w.bottom_rad + w.divergence_rad, w.period_s);
    if (w.rows > 65535)
        throw UsageError(fmt::format("sensor '{}': has {} rows, expected at most 65535", w.name, w.rows));
    RayTable rays;
    rays.rows = w.rows;
    rays.columns = w.columns;
    rays.divergence_rad = static_cast<float>(w.divergence_rad);
    for (int row = 0; row < w.rows; ++row) {
        const double elevation = between(w.top_rad, w.bottom_rad, row, w.rows), c = std::cos(elevation);
        for (int column = 0; column < w.columns; ++column) {
            const double azimuth = between(w.left_rad, w.right_rad, column, w.columns);
            const double time_s = ((column + 0.5) / w.columns - 0.5) * w.period_s;
            add_ray(rays, {c * std::cos(azimuth), c * std::sin(azimuth), std::sin(elevation)}, time_s, row);
        }
    }
    return rays;
}

RayTable make_rays(const FixedPattern& pattern, double time_s) {
    if (const auto* rosette = std::get_if<Rosette>(&pattern)) return make_rays(*rosette, time_s);
    if (const auto* window = std::get_if<ScanningWindow>(&pattern)) return make_rays(*window);
    return std::get<RayTable>(pattern);
}

double period_of(const FixedPattern& pattern) {
    if (const auto* rosette = std::get_if<Rosette>(&pattern)) return rosette->period_s;
    const auto* window = std::get_if<ScanningWindow>(&pattern);
    return window ? window->period_s : 0.0;
}

std::optional<FixedPattern> fixed_pattern(const SensorModel& sensor) {
    return std::visit(
        [](const auto& pattern) -> std::optional<FixedPattern> {
            if constexpr (std::is_same_v<std::decay_t<decltype(pattern)>, SpinningSensor>) return {};
            else return pattern;
        },
        sensor.pattern);
}

RayTable make_rays(const SensorModel& sensor, double time_s) {
    if (const auto* spinning = std::get_if<SpinningSensor>(&sensor.pattern)) return make_rays(*spinning);
    return make_rays(*fixed_pattern(sensor), time_s);
}

}  // namespace relidar
