// SPDX-License-Identifier: Apache-2.0
#include "log/clouds/cloud_units.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include <fmt/format.h>

namespace relidar::bag {
namespace {

// A unit of point times (such as ms) is accepted only if (cloud duration / time between
// clouds) is within these limits.
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
std::vector<TimeRange> list_point_time_ranges(const std::vector<folder::PointTable>& clouds,
                                              const std::vector<double>& cloud_stamps_s) {
    std::vector<TimeRange> ranges;
    for (std::size_t c = 0; c < clouds.size(); ++c) {
        TimeRange range{INFINITY, -INFINITY, cloud_stamps_s[c]};
        if (const folder::PointFieldView* times = clouds[c].find_field(folder::PointAttribute::time))
            times->call_with_value_reader([&](const auto& time_at) {
                for (std::size_t i = 0; i < clouds[c].n; ++i)
                    if (const auto t = double(time_at(i)); std::isfinite(t)) {
                        range.first = std::min(range.first, t);
                        range.last = std::max(range.last, t);
                    }
            });
        if (range.first <= range.last) ranges.push_back(range);
    }
    return ranges;
}

PointTimeReference find_reference_of_point_times(const std::vector<TimeRange>& time_ranges,
                                                 double time_unit_s) {
    const auto all = [&](auto test) { return std::ranges::all_of(time_ranges, test); };
    const auto are_times_close = [&](double first, double second) {
        return std::abs(first - second) <= kBesideStamp_s;
    };
    if (all([&](const TimeRange& r) {
            return are_times_close(r.first * time_unit_s, 0.0) && are_times_close(r.last * time_unit_s, 0.0);
        }))
        return PointTimeReference::stamp;
    if (all([&](const TimeRange& r) {
            return are_times_close(r.first * time_unit_s, r.stamp_s) &&
                   are_times_close(r.last * time_unit_s, r.stamp_s);
        }))
        return PointTimeReference::epoch;
    return PointTimeReference::sensor_clock;
}

/// Returns a text for the user that says at which moment the times of points are 0.
const char* describe_point_time_reference(PointTimeReference reference) {
    if (reference == PointTimeReference::stamp) return "the times are relative to the stamp of the cloud";
    if (reference == PointTimeReference::epoch)
        return "the times use the same clock as the stamps of the clouds";
    return "the times use the clock of the sensor, so the first time in a cloud is set to the stamp of the "
           "cloud";
}

void set_point_time_unit_from_ranges(PointCloudUnits& units, const std::vector<TimeRange>& time_ranges,
                                     double cloud_interval_s) {
    if (time_ranges.empty()) return;
    std::vector<double> spans;
    for (const TimeRange& r : time_ranges) spans.push_back(r.last - r.first);
    std::ranges::sort(spans);
    const double span = spans[spans.size() / 2];
    units.is_deskewed = spans.back() == 0.0;
    for (const TimeUnit& unit : kTimeUnits) {
        const double turns = span * unit.seconds / cloud_interval_s;
        if (!(turns >= kLeastSpan && turns <= kMostSpan)) continue;
        units.zero = find_reference_of_point_times(time_ranges, unit.seconds);
        units.time_unit_s = unit.seconds;
        units.about = fmt::format(
            "the times of points are read in {}; {}; a cloud lasts {:.1f} ms from its first to its last "
            "point",
            unit.name, describe_point_time_reference(units.zero), 1e3 * span * unit.seconds);
        return;
    }
    units.about = units.is_deskewed
                      ? "all points of a cloud have the same time, so each cloud is assumed to be "
                        "motion-compensated to its stamp"
                      : fmt::format(
                            "the times of points are ignored, because no unit of time fits them: the points "
                            "of a cloud span {:.4g} units, but clouds are {:.3g} s apart",
                            span, cloud_interval_s);
}

}  // namespace

PointCloudUnits estimate_time_and_intensity_units(const std::vector<folder::PointTable>& clouds,
                                                  const std::vector<double>& cloud_stamps_s,
                                                  double cloud_interval_s) {
    PointCloudUnits units;
    set_point_time_unit_from_ranges(units, list_point_time_ranges(clouds, cloud_stamps_s), cloud_interval_s);
    units.meaning = folder::interpret_point_fields(clouds);
    return units;
}

}  // namespace relidar::bag
