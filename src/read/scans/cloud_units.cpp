// SPDX-License-Identifier: Apache-2.0
#include "read/scans/cloud_units.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include <fmt/format.h>

#include <relidar/base/arrays.hpp>

#include "base/median.hpp"
#include "read/files/scan_npz.hpp"
#include "read/scans/folder_points.hpp"
#include "read/scans/point_times.hpp"
#include "read/scans/pose_conventions.hpp"

namespace relidar::read {
namespace {

// limits of (cloud duration / time between clouds) with a possible unit
constexpr double kMinDuration = 0.05, kMaxDuration = 3.0;
// Maximum difference between the time of a point and the stamp of its cloud.
constexpr double kBesideStamp_s = 2.0;
constexpr double kMinCloudShare = 0.8;  // minimum share of clouds, or of times, that must agree
// If all points of a cloud have the same time and it can change only in steps above this
// value, the time is rounded: 32-bit floats of seconds since 1970 have steps of 128.
constexpr double kLargestStep = 16.0;

constexpr const char* kReferenceTexts[] = {  // by PointTimeReference
    "not used", "0 at the stamp of the scan", "on the clock of the stamps",
    "on an unknown clock, so the first point gets the stamp"};

struct TimeUnit {
    const char* name;
    double seconds;
};
constexpr std::array<TimeUnit, 4> kTimeUnits = {{{"s", 1.0}, {"ms", 1e-3}, {"us", 1e-6}, {"ns", 1e-9}}};

/// Times of a cloud, in the unit of the file.
struct TimeRange {
    double first, last;       ///< without outliers
    double stamp_s;           ///< stamp of the message, in seconds
    double resolution = 0.0;  ///< distance between neighbouring values; 0: exact
};

std::vector<TimeRange> list_time_ranges(const std::vector<PointTable>& clouds,
                                        const std::vector<double>& cloud_stamps_s) {
    std::vector<TimeRange> ranges;
    for (std::size_t c = 0; c < clouds.size(); ++c)
        if (const auto range = find_time_range(clouds[c]))
            ranges.push_back({(*range)[0], (*range)[1], cloud_stamps_s[c], time_resolution(clouds[c])});
    return ranges;
}

/// Returns true if a test holds for most clouds. Some clouds can have wrong times.
template <class Test>
bool holds_for_most(const std::vector<TimeRange>& ranges, const Test& test) {
    return double(std::ranges::count_if(ranges, test)) >= kMinCloudShare * double(ranges.size());
}

/// Returns true if point times advance from cloud to cloud like the stamps, as those of a
/// clock do. Offsets within the cloud do not advance.
bool follow_stamps(const std::vector<TimeRange>& ranges, double time_unit_s) {
    std::size_t n_like_stamps = 0;
    for (std::size_t k = 1; k < ranges.size(); ++k) {
        const double step_s = ranges[k].stamp_s - ranges[k - 1].stamp_s,
                     time_step_s = time_unit_s * (ranges[k].first - ranges[k - 1].first);
        n_like_stamps += std::abs(time_step_s - step_s) < 0.5 * std::abs(step_s);
    }
    return 2 * n_like_stamps + 1 > ranges.size();  // more than half of the steps
}

/// Returns true if the first times of most clouds differ by less than a sweep, as those
/// of offsets do. Times within a second, for example, differ more.
bool are_firsts_similar(const std::vector<TimeRange>& ranges, double time_unit_s, double sweep_s) {
    std::vector<double> first_s;
    for (const TimeRange& range : ranges) first_s.push_back(range.first * time_unit_s);
    const double middle_s = compute_median(first_s);
    return holds_for_most(ranges, [&](const TimeRange& range) {
        return std::abs(range.first * time_unit_s - middle_s) <= sweep_s;
    });
}

/// Returns what the point times are relative to: the stamp of the cloud (if they are near
/// 0), the zero of the stamps (epoch, if they are near the stamps), or else another zero.
PointTimeReference find_time_reference(const std::vector<TimeRange>& ranges, double unit_s, double sweep_s) {
    const auto is_near = [&](const TimeRange& range, double time_s) {
        return std::abs(range.first * unit_s - time_s) <= kBesideStamp_s &&
               std::abs(range.last * unit_s - time_s) <= kBesideStamp_s;
    };
    const auto is_near_zero = [&](const TimeRange& range) { return is_near(range, 0.0); };
    const auto is_near_stamp = [&](const TimeRange& range) { return is_near(range, range.stamp_s); };
    // Small times can also be those of a clock that started recently (they then follow
    // the stamps), or that restarts every second (the first times then differ).
    if (holds_for_most(ranges, is_near_zero) && !follow_stamps(ranges, unit_s) &&
        are_firsts_similar(ranges, unit_s, sweep_s))
        return PointTimeReference::stamp;
    return holds_for_most(ranges, is_near_stamp) ? PointTimeReference::epoch
                                                 : PointTimeReference::sensor_clock;
}

/// Returns true if the time of a cloud is its stamp in some unit, rounded to steps that
/// are too long for the time between clouds.
bool is_rounded_stamp(const TimeRange& cloud, double cloud_interval_s) {
    return std::ranges::any_of(kTimeUnits, [&](const TimeUnit& unit) {
        const double resolution_s = cloud.resolution * unit.seconds;
        const double from_stamp_s = std::abs(cloud.first * unit.seconds - cloud.stamp_s);
        return is_coarse_time(resolution_s, cloud_interval_s) && from_stamp_s < kBesideStamp_s + resolution_s;
    });
}

/// Returns true if the times of clouds were rounded, for example to 32-bit floats, so
/// that they do not order the clouds. In each cloud, all points have the same time. The
/// unit of the times is not known yet, so all units are tried.
bool are_cloud_times_coarse(const std::vector<TimeRange>& ranges, double cloud_interval_s) {
    const TimeRange& typical = ranges[ranges.size() / 2];
    if (is_rounded_stamp(typical, cloud_interval_s)) return true;
    // Times that advance like the stamps are exact times of the clouds.
    const auto is_exact = [&](const TimeUnit& unit) { return follow_stamps(ranges, unit.seconds); };
    if (ranges.size() > 1 && std::ranges::any_of(kTimeUnits, is_exact)) return false;
    // A constant, such as 0 for "no time", is not rounded, unless it is very large.
    const bool is_constant = std::ranges::all_of(
        ranges, [&](const TimeRange& range) { return range.first == ranges.front().first; });
    return typical.resolution > kLargestStep ||
           (!is_constant && is_coarse_time(typical.resolution, cloud_interval_s));
}

/// Returns the longest of the units s, ms, us and ns with which the duration of a cloud
/// is plausible compared with the time between clouds, or null.
const TimeUnit* find_time_unit(double span, double cloud_interval_s) {
    for (const TimeUnit& unit : kTimeUnits) {
        const double duration = span * unit.seconds / cloud_interval_s;
        if (duration >= kMinDuration && duration <= kMaxDuration) return &unit;
    }
    return nullptr;
}

/// Returns the unit and the reference of the point times, with a note. If no unit fits,
/// the reference is `none`. Does not set the fields.
/// @param signed_ranges  the same times if large unsigned numbers are negative offsets
PointCloudUnits estimate_times(const std::vector<TimeRange>& ranges,
                               const std::vector<TimeRange>& signed_ranges, double cloud_interval_s,
                               const Conventions& set) {
    PointCloudUnits units;
    if (ranges.empty()) return units;
    std::vector<double> spans;  // [clouds]
    for (const TimeRange& range : ranges) spans.push_back(range.last - range.first);
    const double usual_span = compute_median(spans);

    // Some conversions lose the precision of times, for example those to 32-bit floats.
    const TimeRange& cloud = ranges[ranges.size() / 2];
    if (usual_span > 0.0 ? is_coarse_time(cloud.resolution, usual_span)
                         : are_cloud_times_coarse(ranges, cloud_interval_s)) {
        units.time_note = describe_coarse(cloud.last, cloud.resolution);
        return units;
    }
    // After motion compensation, all points of a cloud can have the same time.
    units.is_deskewed = std::ranges::max(spans) == 0.0;
    if (units.is_deskewed) return units;
    const TimeUnit* unit = set.time_unit == Conventions::TimeUnit::automatic
                               ? find_time_unit(usual_span, cloud_interval_s)
                               : &kTimeUnits[std::size_t(set.time_unit) - 1];
    if (!unit) {
        units.time_note = fmt::format(
            "the times of points are ignored, because no unit of time fits them: the points of a cloud span "
            "{:.4g} units, but clouds are {:.3g} s apart; set conventions.time_unit",
            usual_span, cloud_interval_s);
        return units;
    }
    const double duration_s = usual_span * unit->seconds;
    const double sweep_s = std::max({duration_s, cloud_interval_s, kUsualPeriod_s});
    units.time_unit_s = unit->seconds;
    units.time_reference = find_time_reference(ranges, unit->seconds, sweep_s);
    // Without signs, negative offsets look like the large times of a clock.
    if (units.time_reference == PointTimeReference::sensor_clock &&
        find_time_reference(signed_ranges, unit->seconds, sweep_s) == PointTimeReference::stamp)
        units.time_reference = PointTimeReference::stamp;
    if (set.time_zero != Conventions::TimeZero::automatic)
        units.time_reference = PointTimeReference(set.time_zero);
    units.time_reason = fmt::format("guess: a scan then lasts {:.1f} ms", 1e3 * usual_span * unit->seconds);
    return units;
}

namespace fs = std::filesystem;

/// Reads the points of a few scans. Leaves out files of rays, which have no points.
/// @param frames  set to the index of the file of each table
std::vector<PointTable> sample_tables(const std::vector<fs::path>& scan_files,
                                      const std::vector<std::string>& column_names,
                                      std::vector<std::size_t>& frames) {
    const bool are_npz_rays = !has_npz_points(scan_files);
    std::vector<std::size_t> with_points;
    for (std::size_t i = 0; i < scan_files.size(); ++i)
        if (!are_npz_rays || is_point_file(scan_files[i])) with_points.push_back(i);
    std::vector<PointTable> samples;
    read_samples(with_points.size(), [&](std::size_t k) {
        samples.push_back(read_point_file(scan_files[with_points[k]], column_names));
        frames.push_back(with_points[k]);
    });
    return samples;
}

/// Reads a few .npz files with rays as tables with the fields "intensity" and "time",
/// which show the scale and the resolution of the values.
std::vector<PointTable> sample_images(std::vector<fs::path> files) {
    std::erase_if(files, [](const fs::path& file) { return file.extension() != ".npz"; });
    std::vector<PointTable> samples;
    read_samples(files.size(), [&](std::size_t i) {
        const std::vector<NamedArray> arrays = read_npz(files[i]);
        PointTable& table = samples.emplace_back(arrays.empty() ? 0 : arrays[0].element_count());
        for (const char* name : {"intensity", "time"})
            if (const NamedArray* array = find_array(arrays, name);
                array && array->element_count() == table.n)
                table.add_value_field(name, ScalarType::f8, array->to_doubles(), "");
    });
    return samples;
}

/// Returns true if most times of the samples can be those of their scans, with the unit
/// and the reference in `units`. Some points can have wrong times.
bool are_times_plausible(const PointFileUnits& units, const std::vector<PointTable>& samples,
                         const std::vector<double>& frame_times_s) {
    std::size_t n_times = 0, n_plausible = 0;
    for (std::size_t i = 0; i < samples.size(); ++i)
        if (const PointFieldView* times = samples[i].find_field(PointAttribute::time))
            times->for_each(samples[i].n, [&](std::size_t, double time) {
                const double offset_s =
                    time * units.time_unit_s - (units.absolute_times ? frame_times_s[i] : 0.0);
                ++n_times;
                n_plausible += std::abs(offset_s) <= kMaxTimeOffset_s;
            });
    return double(n_plausible) >= kMinCloudShare * double(n_times);
}

/// Estimates the unit and the reference of point times that cannot have the default unit.
/// If none fits, the times are ignored.
void set_time_units(PointFileUnits& units, const PointCloudUnits& estimate, Notes& notes) {
    if (estimate.time_reference == PointTimeReference::none) {
        notes.push_back(estimate.is_deskewed
                            ? "all points of a scan have the same time, so the times are ignored"
                            : estimate.time_note);
        units.ignore_times = true;
        return;
    }
    units.time_unit_s = estimate.time_unit_s;
    units.skip_wrong_times = true;
    if (!units.is_reference_open) return;
    units.absolute_times = estimate.time_reference != PointTimeReference::stamp;
    units.starts_at_frame = estimate.time_reference == PointTimeReference::sensor_clock;
}

/// Makes the reader ignore the times, with a note, if those of a sample have lost their
/// precision: neighbouring values are too distant to order the points of a sweep.
void drop_coarse_times(PointFileUnits& units, const std::vector<PointTable>& samples, Notes& notes) {
    for (const PointTable& cloud : samples) {
        const auto range = find_time_range(cloud);
        if (!range) continue;
        const auto [first, last] = *range;
        const double resolution = time_resolution(cloud);
        const double span = last > first ? last - first : kUsualPeriod_s / units.time_unit_s;
        if (!is_coarse_time(resolution, span)) continue;
        units.ignore_times = true;
        notes.push_back(describe_coarse(last, resolution));
        return;
    }
}

}  // namespace

PointCloudUnits estimate_cloud_units(const std::vector<PointTable>& clouds,
                                     const std::vector<double>& cloud_stamps_s, double cloud_interval_s,
                                     const Conventions& set) {
    // Times of counters that overflow within a cloud become continuous.
    std::vector<PointTable> continuous_clouds = clouds;
    for (PointTable& cloud : continuous_clouds) unwrap_times(cloud, /*are_offsets=*/false);
    // The same clouds if large unsigned times are negative offsets. estimate_times()
    // decides which of both is right.
    std::vector<PointTable> signed_clouds = continuous_clouds;
    std::ranges::for_each(signed_clouds, restore_signs);

    PointCloudUnits units =
        estimate_times(list_time_ranges(continuous_clouds, cloud_stamps_s),
                       list_time_ranges(signed_clouds, cloud_stamps_s), cloud_interval_s, set);
    units.fields = interpret_fields(continuous_clouds);
    return units;
}

void list_times(Log& log, const PointCloudUnits& units, const Conventions& set, const std::string& lidar) {
    if (units.time_reason.empty()) return;
    const auto unit = std::ranges::find(kTimeUnits, units.time_unit_s, &TimeUnit::seconds);
    list_convention(log,
                    {"unit of point times" + lidar, unit->name,
                     set.time_unit != Conventions::TimeUnit::automatic ? kFromSetting : units.time_reason,
                     "conventions.time_unit"});
    list_convention(log, {"zero of point times" + lidar, kReferenceTexts[std::size_t(units.time_reference)],
                          set.time_zero != Conventions::TimeZero::automatic ? kFromSetting
                          : units.time_reason.starts_with("guess: ")        ? "guess: times of some scans"
                                                                            : units.time_reason,
                          "conventions.time_zero"});
}

IntensityScale choose_scale(const IntensityScale& other, const Conventions& set) {
    return set.intensity_max > 0.0 ? IntensityScale{set.intensity_max, true, kFromSetting} : other;
}

void list_scale(Log& log, const IntensityScale& scale, const std::string& lidar) {
    list_convention(log, {"intensity" + lidar, fmt::format("0 to {:.4g}", scale.max), scale.reason,
                          "conventions.intensity_max"});
    if (!scale.is_sure && scale.max > 1.0)
        log.notes.push_back(
            fmt::format("the intensities{} are divided by {:.4g}, but they could also be "
                        "percentages; set conventions.intensity_max",
                        lidar, scale.max));
}

void fill_units(PointFileUnits& units, const std::vector<fs::path>& scan_files,
                const std::string& declared_by, const Conventions& set, Log& log) {
    std::vector<std::size_t> frames;  // [samples]
    std::vector<PointTable> samples = sample_tables(scan_files, units.columns, frames);
    std::vector<double> frame_times_s;  // [samples]
    for (const std::size_t frame : frames) frame_times_s.push_back(log.frames[frame].time_s);
    const bool sets_unit = set.time_unit != Conventions::TimeUnit::automatic,
               sets_zero = set.time_zero != Conventions::TimeZero::automatic;
    std::string time_reason = units.is_unit_open ? "default" : declared_by;
    if (!samples.empty()) {  // Times in images of rays have one unit.
        if (sets_unit) units.time_unit_s = kTimeUnits[std::size_t(set.time_unit) - 1].seconds;
        if (sets_zero) {
            units.absolute_times = set.time_zero != Conventions::TimeZero::stamp;
            units.starts_at_frame = set.time_zero == Conventions::TimeZero::first_point;
            units.is_reference_open = false;
        }
        const bool is_open = sets_unit ? units.is_reference_open : units.is_unit_open;
        if (is_open && !are_times_plausible(units, samples, frame_times_s)) {
            const PointCloudUnits estimate =
                estimate_cloud_units(samples, frame_times_s, estimate_sweep_s(log, 0), set);
            time_reason = estimate.time_reason;
            set_time_units(units, estimate, log.notes);
        }
    }
    const bool has_times = std::ranges::any_of(
        samples, [](const PointTable& table) { return find_time_range(table).has_value(); });
    for (PointTable& cloud : samples) unwrap_times(cloud, /*are_offsets=*/!units.absolute_times);
    PointFieldSemantics fields = interpret_fields(samples);
    if (samples.empty()) {  // The log has range images instead of points.
        samples = sample_images(scan_files);
        fields.scale = estimate_scale(list_values(samples, "intensity"));
    }
    if (!units.ignore_times) drop_coarse_times(units, samples, log.notes);
    if (!units.ignore_times && has_times) {
        const PointTimeReference reference = units.starts_at_frame  ? PointTimeReference::sensor_clock
                                             : units.absolute_times ? PointTimeReference::epoch
                                                                    : PointTimeReference::stamp;
        list_times(log,
                   {.time_reference = reference,
                    .time_unit_s = units.time_unit_s,
                    .fields = {},
                    .time_note = {},
                    .time_reason = time_reason},
                   set, "");
    }
    units.intensity_field = fields.intensity_field;
    units.no_return = fields.no_return;
    units.returns = fields.returns;
    // If the scale is not sure, intensities above 1 are an error.
    if (units.intensity_max) fields.scale = {*units.intensity_max, true, declared_by};
    else if (fields.scale.is_sure && fields.scale.max > 1.0) units.intensity_max = fields.scale.max;
    else fields.scale.max = 1.0;
    if (set.intensity_max > 0.0) units.intensity_max = set.intensity_max;
    fields.scale = choose_scale(fields.scale, set);
    list_scale(log, fields.scale, "");
    log.notes.insert(log.notes.end(), fields.notes.begin(), fields.notes.end());
}

}  // namespace relidar::read
