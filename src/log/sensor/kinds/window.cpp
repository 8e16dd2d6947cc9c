// SPDX-License-Identifier: Apache-2.0
// Reads, writes and generates sensors of the kind "window". In such a sensor, mirrors
// scan a rectangular field of view.
#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "log/sensor/pattern_kinds.hpp"

namespace relidar {

RayTable make_rays(const ScanningWindow& w) {
    pattern_detail::check_count(w.name, double(w.rows) * double(w.columns));
    pattern_detail::check_finite(
        w.name, w.left_rad + w.right_rad + w.top_rad + w.bottom_rad + w.divergence_rad, w.period_s);
    if (w.rows > 65535)
        throw UsageError(fmt::format("sensor '{}' has {} rows, expected at most 65535", w.name, w.rows));
    RayTable rays;
    rays.rows = w.rows;
    rays.columns = w.columns;
    rays.divergence_rad = static_cast<float>(w.divergence_rad);
    for (int row = 0; row < w.rows; ++row) {
        const double elevation = pattern_detail::between(w.top_rad, w.bottom_rad, row, w.rows),
                     c = std::cos(elevation);
        for (int column = 0; column < w.columns; ++column) {
            const double azimuth = pattern_detail::between(w.left_rad, w.right_rad, column, w.columns);
            const double time_s = ((column + 0.5) / w.columns - 0.5) * w.period_s;
            pattern_detail::add_ray(rays, {c * std::cos(azimuth), c * std::sin(azimuth), std::sin(elevation)},
                                    time_s, row);
        }
    }
    return rays;
}

namespace {

struct WindowFunctions {
    using Pattern = ScanningWindow;

    static SensorModel parse(const JsonField& field, const std::string& of) {
        pattern_detail::check_members(field, {"rows", "columns"}, {"left", "right", "top", "bottom"});
        const auto [name, limits, period_s, divergence_rad] = pattern_detail::read_common(field, of);
        const ScanningWindow window{.name = name,
                                    .rows = static_cast<int>(field.at("rows").integer(1, 65535)),
                                    .columns = static_cast<int>(field.at("columns").integer(1, 1'000'000)),
                                    .left_rad = pattern_detail::read_angle(field, "left", 180.0),
                                    .right_rad = pattern_detail::read_angle(field, "right", 180.0),
                                    .top_rad = pattern_detail::read_angle(field, "top", 90.0),
                                    .bottom_rad = pattern_detail::read_angle(field, "bottom", 90.0),
                                    .period_s = period_s,
                                    .divergence_rad = divergence_rad};
        if (std::size_t(window.rows) * std::size_t(window.columns) > kMaxRays)
            field.fail(fmt::format("found {} rows x {} columns", window.rows, window.columns),
                       fmt::format("expected at most {} rays", kMaxRays));
        return {name, "", limits, window};
    }
    static nlohmann::ordered_json write(const ScanningWindow& w) {
        return {{"rows", w.rows},         {"columns", w.columns},
                {"left_rad", w.left_rad}, {"right_rad", w.right_rad},
                {"top_rad", w.top_rad},   {"bottom_rad", w.bottom_rad},
                {"period_s", w.period_s}, {"divergence_rad", w.divergence_rad}};
    }
    static RayTable make_rays(const ScanningWindow& w, double) { return relidar::make_rays(w); }
    static PatternSummary describe(const ScanningWindow& w) {
        return {.n_rays = std::size_t(w.rows) * std::size_t(w.columns),
                .period_s = w.period_s,
                .sweep = AzimuthSweep{w.left_rad, w.right_rad, w.columns}};
    }
};

}  // namespace

PatternKind window_kind() {
    return pattern_kind<WindowFunctions>("window", "rows, columns, left_deg, right_deg, top_deg, bottom_deg");
}

}  // namespace relidar
