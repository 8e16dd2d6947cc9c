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
// A counter overflows in a cloud if its times span nearly a period, and leave out more
// than half of the period.
constexpr double kMinSpanShare = 0.9, kLeastPause = 0.5;
// Times in the last part of the period of a counter can be negative offsets.
constexpr double kLastPart = 15.0 / 16.0;
// Plausible time from the first to the last point of a scan, relative to the time between
// scans. The lower limit is small, because a log may have only some of the scans.
constexpr double kShortestSpan = 0.01, kLongestSpan = 3.0;

/// Returns true if a counter with this period overflows in the cloud. Sets `limit` to a
/// value below the times before the overflow and above the other times.
bool is_period(const std::vector<double>& times, std::array<double, 2> range, double period, double& limit) {
    const auto [first, last] = range;
    if (last - first < kMinSpanShare * period || last - first > period) return false;
    limit = 0.5 * (first + last);
    double before = first, after = last;
    for (const double t : times) {
        if (t < limit) before = std::max(before, t);
        else after = std::min(after, t);
    }
    return after - before > kLeastPause * period && after - before < last - first;
}

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

/// Returns the span of sorted values without their outermost tenths, extrapolated, and
/// the index of the last value of the lower tenth.
template <class Number>
std::pair<double, std::size_t> estimate_span(const std::vector<Number>& sorted) {
    constexpr double kOuterShare = 0.1;
    const auto outer = std::size_t(kOuterShare * double(sorted.size() - 1));
    return {double(sorted[sorted.size() - 1 - outer] - sorted[outer]) / (1.0 - 2.0 * kOuterShare), outer};
}

}  // namespace

std::optional<std::array<double, 2>> find_time_range(const PointTable& table) {
    std::vector<double> times = read_times(table);
    std::erase_if(times, [](double t) { return !std::isfinite(t); });
    if (times.empty()) return std::nullopt;
    std::ranges::sort(times);
    constexpr double kMaxSpanRatio = 10.0;  // points can be in a small part of the sweep
    // Keeps times that are at most ten spans outside of the middle 80 % of the times.
    const auto [span, outer] = estimate_span(times);
    if (span == 0.0) return std::array{times.front(), times.back()};
    return std::array{
        *std::ranges::lower_bound(times, times[outer] - kMaxSpanRatio * span),
        *std::prev(std::ranges::upper_bound(times, times[times.size() - 1 - outer] + kMaxSpanRatio * span))};
}

void unwrap_times(PointTable& table, bool are_offsets) {
    std::vector<double> times = read_times(table);
    const std::array<double, 2> range = value_range(times);
    double limit = 0.0, period = 0.0;
    const auto test = [&](double candidate) {
        if ((period == 0.0 || candidate < period) && is_period(times, range, candidate, limit))
            period = candidate;
    };
    // The shortest possible period is right, because times span nearly all of it.
    std::ranges::for_each(kCounterPeriods, test);
    for (const double period_s : kClockPeriods_s)
        for (const double unit : kUnitsOfSecond)
            // Clocks can repeat a second or an hour without being 0 there.
            if (!are_offsets &&
                (period_s == 1.0 || period_s == 3600.0 || (range[0] >= 0.0 && range[1] <= period_s * unit)))
                test(period_s * unit);
    if (period == 0.0) return;
    for (double& t : times) t -= t >= limit ? period : 0.0;
    replace_times(table, std::move(times));
}

void restore_signs(PointTable& table) {
    std::vector<double> times = read_times(table);
    if (times.empty()) return;
    const auto [first, last] = value_range(times);
    double number_period = 0.0;  // of an integer type; 0: floats, which come from counters of 32 bits
    table.find_field(PointAttribute::time)->with_reader([&](const auto& time_at) {
        using Number = decltype(time_at(0));
        if (!std::is_floating_point_v<Number>) number_period = std::ldexp(1.0, 8 * sizeof(Number));
    });
    for (const double period : kCounterPeriods) {
        const bool is_counter = number_period == 0.0 ? period != kCounterPeriods[0] : period == number_period;
        // Times are negative only if all of them are in the last part of the period.
        if (!is_counter || first < kLastPart * period || last >= period) continue;
        for (double& t : times) t -= period;
        return replace_times(table, std::move(times));
    }
}

double time_resolution(const PointTable& table) {
    constexpr double kLeastEpoch_s = 1e9;
    const std::vector<double> times = read_times(table);
    if (times.empty()) return 0.0;
    const auto [first, last] = value_range(times);
    // A number that a 32-bit float can represent exactly was probably stored as one.
    const bool is_float = std::ranges::all_of(
                   times, [](double t) { return !std::isfinite(t) || double(float(t)) == t; }),
               is_whole = std::ranges::all_of(
                   times, [](double t) { return !std::isfinite(t) || std::round(t) == t; });
    const float largest = float(std::max(std::abs(first), std::abs(last)));
    // distance between the largest absolute time and the next larger float
    double resolution = is_float ? double(std::nextafter(largest, INFINITY)) - double(largest) : 0.0;
    if (is_whole && first > kLeastEpoch_s && last < 4.0 * kLeastEpoch_s)
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
    return times_s.empty() ? 0.0 : estimate_span(times_s).first;
}

std::string describe_span(const std::vector<LidarPoints>& scans, double frame_step_s) {
    std::vector<double> spans_s, largest_offsets_s;
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
    std::vector<double> middles_s;
    for (const LidarPoints& scan : scans)
        if (!scan.time_offset_s.empty()) middles_s.push_back(double(compute_median(scan.time_offset_s)));
    if (middles_s.empty()) return std::nullopt;
    const double middle_s = compute_median(middles_s);
    const auto n =
        std::ranges::count_if(middles_s, [&](double t_s) { return std::abs(t_s - middle_s) <= limit_s; });
    return double(n) >= kMostScans * double(middles_s.size()) ? std::optional(middle_s) : std::nullopt;
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
    std::vector<std::size_t> right;
    for (std::size_t i = 0; i < n; ++i)
        if (std::abs(double(points.time_offset_s[i]) - *middle_s) <= limit_s) right.push_back(i);
    if (right.size() < n) select_points(points, right);
    return n - right.size();
}

}  // namespace relidar::read
