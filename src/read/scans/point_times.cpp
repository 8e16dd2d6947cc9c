// SPDX-License-Identifier: Apache-2.0
#include "read/scans/point_times.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <type_traits>
#include <utility>

#include <fmt/format.h>

#include <relidar/base/math.hpp>

#include "base/median.hpp"

namespace relidar::read {
namespace {

// Counters of 16 and 32 bits, which a program may have divided by a power of 1000.
constexpr std::array kCounterPeriods = {65536.0, 4294967296.0, 4294967.296, 4294.967296, 4.294967296};
// a second, a minute, an hour, a day and a week
constexpr std::array kClockPeriods_s = {1.0, 60.0, 3600.0, 86400.0, 604800.0};
constexpr std::array kUnitsOfSecond = {1.0, 1e3, 1e6, 1e9};
// A counter overflows if the times span nearly a period, but leave out more than half.
constexpr double kMinSpanShare = 0.9, kLeastPause = 0.5;
// Times in the last part of the period of a counter can be negative offsets.
constexpr double kLastPart = 15.0 / 16.0;
// Plausible time from the first to the last point of a scan, relative to the time between
// scans. The lower limit is small, because a log may have only some of the scans.
constexpr double kShortestSpan = 0.01, kLongestSpan = 3.0;

/// Lists the periods after which times in this range can jump back, in ascending order:
/// those of counters with 16 or 32 bits, and those of clocks. The unit of the file is not
/// known here, so the periods of clocks are listed in s, ms, us and ns.
/// @param are_offsets  true: times are relative to the scan, so no clock period is listed
std::vector<double> list_periods(std::array<double, 2> range, bool are_offsets) {
    std::vector<double> periods(kCounterPeriods.begin(), kCounterPeriods.end());
    if (are_offsets) return periods;
    for (const double period_s : kClockPeriods_s)
        for (const double units_per_s : kUnitsOfSecond) {
            const double period = period_s * units_per_s;
            // Times within a minute, day or week begin at 0. Those that jump back every
            // second or hour can begin at another value, so they can be in any range.
            const bool can_begin_anywhere = period_s == 1.0 || period_s == 3600.0;
            const bool is_within_period = range[0] >= 0.0 && range[1] <= period;
            if (can_begin_anywhere || is_within_period) periods.push_back(period);
        }
    std::ranges::sort(periods);
    return periods;
}

/// Returns true if the field can contain the values of a counter with this period. An
/// integer counts up to the limit of its type. A float is a counter of 32 bits that a
/// program may have divided, so it has any period but that of 16 bits.
bool can_have_period(const PointFieldView& field, double period) {
    bool can_have = false;
    field.with_reader([&](const auto& time_at) {
        using Number = decltype(time_at(0));
        const double limit_of_type = std::ldexp(1.0, 8 * sizeof(Number));
        can_have = std::is_floating_point_v<Number> ? period != kCounterPeriods[0] : period == limit_of_type;
    });
    return can_have;
}

/// Returns the smallest and the largest finite time.
std::array<double, 2> value_range(const std::vector<double>& times) {
    std::array<double, 2> range{INFINITY, -INFINITY};
    for (const double t : times)
        if (std::isfinite(t)) range = {std::min(range[0], t), std::max(range[1], t)};
    return range;
}

std::vector<double> read_times(const PointTable& table) {
    const PointFieldView* field = table.find_field(PointAttribute::time);
    std::vector<double> times(field ? table.n : 0);
    if (field) field->for_each(table.n, [&](std::size_t i, double t) { times[i] = t; });
    return times;
}

void replace_times(PointTable& table, std::vector<double> times) {
    table.remove_fields(PointAttribute::time);
    table.add_value_field("time", ScalarType::f8, std::move(times), "");
}

/// Span of most values of a sorted array.
struct InnerSpan {
    double span;          ///< of the middle 80 %, extrapolated to all values
    std::size_t n_outer;  ///< number of values that are ignored at each end
};
template <class Number>
InnerSpan estimate_span(const std::vector<Number>& sorted) {
    constexpr double kOuterShare = 0.1;
    const auto n_outer = std::size_t(kOuterShare * double(sorted.size() - 1));
    const auto middle_span = double(sorted[sorted.size() - 1 - n_outer] - sorted[n_outer]);
    return {middle_span / (1.0 - 2.0 * kOuterShare), n_outer};
}

}  // namespace

std::optional<std::array<double, 2>> find_time_range(const PointTable& table) {
    std::vector<double> times = read_times(table);
    std::erase_if(times, [](double t) { return !std::isfinite(t); });
    if (times.empty()) return std::nullopt;
    std::ranges::sort(times);
    // Values this many spans outside of the middle 80 % are outliers. The limit is wide,
    // because most points can be in a small part of the sweep.
    constexpr double kMaxSpanRatio = 10.0;
    const auto [span, n_outer] = estimate_span(times);
    if (span == 0.0) return std::array{times.front(), times.back()};
    const double lowest = times[n_outer] - kMaxSpanRatio * span;
    const double highest = times[times.size() - 1 - n_outer] + kMaxSpanRatio * span;
    const auto first = std::ranges::lower_bound(times, lowest);
    const auto last = std::prev(std::ranges::upper_bound(times, highest));
    return std::array{*first, *last};
}

void unwrap_times(PointTable& table, bool are_offsets) {
    std::vector<double> times = read_times(table);
    const std::array<double, 2> range = value_range(times);
    const auto [smallest, largest] = range;
    // If the counter overflows, the small times follow the overflow and the large times
    // precede it. Between them is a pause, because a scan lasts less than half a period.
    const double middle = 0.5 * (smallest + largest);
    double last_small = smallest, first_large = largest;
    for (const double t : times) {
        if (t < middle) last_small = std::max(last_small, t);
        else first_large = std::min(first_large, t);
    }
    const double span = largest - smallest, pause = first_large - last_small;
    if (!(pause < span)) return;  // only two different times
    // Times span nearly all of the period, so the shortest possible one is right.
    for (const double period : list_periods(range, are_offsets)) {
        if (span < kMinSpanShare * period || span > period || pause <= kLeastPause * period) continue;
        for (double& t : times)
            if (t >= middle) t -= period;
        replace_times(table, std::move(times));
        return;
    }
}

void restore_signs(PointTable& table) {
    std::vector<double> times = read_times(table);
    if (times.empty()) return;
    const auto [first, last] = value_range(times);
    const PointFieldView& field = *table.find_field(PointAttribute::time);
    for (const double period : kCounterPeriods) {
        // Times are negative only if all of them are in the last part of the period.
        const bool are_at_end = first >= kLastPart * period && last < period;
        if (!are_at_end || !can_have_period(field, period)) continue;
        for (double& t : times) t -= period;
        replace_times(table, std::move(times));
        return;
    }
}

double time_resolution(const PointTable& table) {
    constexpr double kLeastEpoch_s = 1e9;  // in the year 2001
    const std::vector<double> times = read_times(table);
    if (times.empty()) return 0.0;
    const auto [first, last] = value_range(times);
    const auto holds_for_all = [&](auto test) {
        return std::ranges::all_of(times, [&](double t) { return !std::isfinite(t) || test(t); });
    };
    double resolution = 0.0;
    // Numbers that a 32-bit float can represent exactly were probably stored as such. The
    // distance to the next larger float is greatest for the largest number.
    if (holds_for_all([](double t) { return double(float(t)) == t; })) {
        const float largest = float(std::max(std::abs(first), std::abs(last)));
        resolution = double(std::nextafter(largest, INFINITY)) - double(largest);
    }
    const bool are_whole = holds_for_all([](double t) { return std::round(t) == t; });
    if (are_whole && first > kLeastEpoch_s && last < 4.0 * kLeastEpoch_s)
        resolution = std::max(resolution, 1.0);
    return resolution;
}

std::string describe_coarse(double time, double resolution) {
    return fmt::format(
        "the times of points are ignored, because they have lost their precision: near {:.10g}, their "
        "smallest step is {:.3g}; expected 64-bit numbers, or times relative to the scan",
        time, resolution);
}

double sweep_span_s(const LidarPoints& points) {
    std::vector<float> times_s = points.time_offset_s;
    std::ranges::sort(times_s);
    return times_s.empty() ? 0.0 : estimate_span(times_s).span;
}

std::string describe_span(const std::vector<LidarPoints>& scans, double frame_step_s) {
    std::vector<double> spans_s, largest_offsets_s;  // [scans with times]
    for (const LidarPoints& points : scans) {
        if (points.time_offset_s.empty()) continue;
        const auto [first_s, last_s] = std::ranges::minmax(points.time_offset_s);
        spans_s.push_back(double(last_s) - double(first_s));
        largest_offsets_s.push_back(std::max(std::abs(double(first_s)), std::abs(double(last_s))));
    }
    if (spans_s.empty()) return "";
    const double span_s = compute_median(std::move(spans_s)),
                 offset_s = compute_median(std::move(largest_offsets_s));
    if (span_s < kShortestSpan * frame_step_s || span_s > kLongestSpan * frame_step_s)
        return fmt::format(
            "the times of the points are probably wrong: those of one scan span {:.3g} s, but a new scan "
            "begins every {:.3g} s; check the unit of the times",
            span_s, frame_step_s);
    if (offset_s > kLongestSpan * frame_step_s)
        return fmt::format(
            "the times of the points are probably wrong: they differ by up to {:.3g} s from the time of "
            "their scan, but a new scan begins every {:.3g} s",
            offset_s, frame_step_s);
    return "";
}

std::optional<double> middle_time_s(const std::vector<LidarPoints>& scans, double limit_s) {
    std::vector<double> middles_s;  // [scans with times] median time of the points
    for (const LidarPoints& scan : scans)
        if (!scan.time_offset_s.empty()) middles_s.push_back(double(compute_median(scan.time_offset_s)));
    if (middles_s.empty()) return std::nullopt;
    const double middle_s = compute_median(middles_s);
    const auto n_near =
        std::ranges::count_if(middles_s, [&](double t_s) { return std::abs(t_s - middle_s) <= limit_s; });
    return double(n_near) >= kMinScanShare * double(middles_s.size()) ? std::optional(middle_s)
                                                                      : std::nullopt;
}

void select_points(LidarPoints& points, const std::vector<std::size_t>& indices) {
    const auto select = [&](auto& values) {
        if (values.empty()) return;
        std::remove_cvref_t<decltype(values)> selected;
        selected.reserve(indices.size());
        for (const std::size_t i : indices) selected.push_back(values[i]);
        values = std::move(selected);
    };
    select(points.position_m);
    select(points.intensity);
    select(points.ring);
    select(points.return_number);
    select(points.time_offset_s);
}

std::size_t remove_mistimed(LidarPoints& points, double limit_s, std::optional<double> middle_s) {
    const std::size_t n = points.time_offset_s.size();
    if (n == 0) return 0;
    if (!middle_s) middle_s = double(compute_median(points.time_offset_s));
    std::vector<std::size_t> kept;
    for (std::size_t i = 0; i < n; ++i)
        if (std::abs(double(points.time_offset_s[i]) - *middle_s) <= limit_s) kept.push_back(i);
    if (kept.size() < n) select_points(points, kept);
    return n - kept.size();
}

}  // namespace relidar::read
