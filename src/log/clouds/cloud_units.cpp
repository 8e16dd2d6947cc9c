// SPDX-License-Identifier: Apache-2.0
#include "log/clouds/cloud_units.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include <fmt/format.h>

namespace relidar::bag {
namespace {

// A time unit is plausible if the duration of a cloud, divided by the time between
// clouds, is in this interval.
constexpr double kLeastSpan = 0.05, kMostSpan = 3.0;
// Maximum difference between the time of a point and the time stamp of its cloud message.
constexpr double kBesideStamp_s = 2.0;

struct TimeUnit {
    const char* name;
    double seconds;
};
constexpr std::array<TimeUnit, 4> kTimeUnits = {{{"s", 1.0}, {"ms", 1e-3}, {"us", 1e-6}, {"ns", 1e-9}}};

struct TimeRange {
    double first, last, stamp_s;
};

/// Returns the times of the first and the last point of each cloud. Skips clouds without
/// point times.
std::vector<TimeRange> list_time_ranges(const std::vector<folder::PointTable>& clouds,
                                        const std::vector<double>& stamps_s) {
    std::vector<TimeRange> ranges;
    for (std::size_t c = 0; c < clouds.size(); ++c) {
        TimeRange range{INFINITY, -INFINITY, stamps_s[c]};
        if (const folder::FieldValues* times = clouds[c].find(folder::PointValue::time))
            times->visit([&](const auto& time_at) {
                for (std::size_t i = 0; i < clouds[c].n; ++i)
                    if (const auto t = double(time_at(i)); std::isfinite(t))
                        range.first = std::min(range.first, t), range.last = std::max(range.last, t);
            });
        if (range.first <= range.last) ranges.push_back(range);
    }
    return ranges;
}

TimeZero find_time_zero(const std::vector<TimeRange>& ranges, double unit_s) {
    const auto all = [&](auto test) { return std::ranges::all_of(ranges, test); };
    const auto is_near = [&](double first, double second) {
        return std::abs(first - second) <= kBesideStamp_s;
    };
    if (all([&](const TimeRange& r) {
            return is_near(r.first * unit_s, 0.0) && is_near(r.last * unit_s, 0.0);
        }))
        return TimeZero::stamp;
    if (all([&](const TimeRange& r) {
            return is_near(r.first * unit_s, r.stamp_s) && is_near(r.last * unit_s, r.stamp_s);
        }))
        return TimeZero::epoch;
    return TimeZero::sensor_clock;
}

void find_time_unit(CloudUnits& units, const std::vector<TimeRange>& ranges, double step_s) {
    if (ranges.empty()) return;
    std::vector<double> spans;
    for (const TimeRange& r : ranges) spans.push_back(r.last - r.first);
    std::ranges::sort(spans);
    const double span = spans[spans.size() / 2];
    units.is_deskewed = spans.back() == 0.0;
    for (const TimeUnit& unit : kTimeUnits) {
        const double turns = span * unit.seconds / step_s;
        if (!(turns >= kLeastSpan && turns <= kMostSpan)) continue;
        units.zero = find_time_zero(ranges, unit.seconds);
        units.time_unit_s = unit.seconds;
        units.about = fmt::format(
            "times of points are read in {}, {}; a cloud lasts {:.1f} ms from its first to "
            "its last point",
            unit.name,
            units.zero == TimeZero::stamp ? "relative to the stamp"
            : units.zero == TimeZero::epoch
                ? "in the same clock as the stamps"
                : "in the clock of the sensor, whose first time in a cloud is set to the "
                  "stamp",
            1e3 * span * unit.seconds);
        return;
    }
    units.about = units.is_deskewed
                      ? "all points of a cloud have the same time, so clouds are read as "
                        "motion-compensated to their stamp"
                      : fmt::format(
                            "times of points are ignored: a cloud spans {:.4g} of an unknown unit, clouds "
                            "are {:.3g} s apart, and no unit of time fits both",
                            span, step_s);
}

}  // namespace

CloudUnits find_units(const std::vector<folder::PointTable>& clouds, const std::vector<double>& stamps_s,
                      double step_s) {
    CloudUnits units;
    find_time_unit(units, list_time_ranges(clouds, stamps_s), step_s);
    units.meaning = folder::find_meaning(clouds);
    return units;
}

}  // namespace relidar::bag
