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

namespace relidar::read {
namespace {

// A unit is accepted only if (cloud duration / time between clouds) is within these
// limits.
constexpr double kMinTurns = 0.05, kMaxTurns = 3.0;
// Maximum difference between the time of a point and the stamp of its cloud.
constexpr double kBesideStamp_s = 2.0;
constexpr double kLeastSweep_s = 0.1;
constexpr double kMostClouds = 0.8;  // minimum share of the clouds that must agree
// Equal times of all points that can only be in steps above this value were probably
// seconds.
constexpr double kLargestStep = 16.0;

constexpr const char* kAboutZero[] = {  // by PointTimeReference
    "", "the times are relative to the stamp of the cloud",
    "the times use the same clock as the stamps of the clouds",
    "the times use the clock of the sensor, so the first time in a cloud is set to its stamp"};

struct TimeUnit {
    const char* name;
    double seconds;
};
constexpr std::array<TimeUnit, 4> kTimeUnits = {{{"s", 1.0}, {"ms", 1e-3}, {"us", 1e-6}, {"ns", 1e-9}}};

struct TimeRange {
    double first, last, stamp_s;
    double resolution = 0.0;  ///< see time_resolution()
};

std::vector<TimeRange> list_time_ranges(const std::vector<PointTable>& clouds,
                                        const std::vector<double>& cloud_stamps_s) {
    std::vector<TimeRange> ranges;
    for (std::size_t c = 0; c < clouds.size(); ++c)
        if (const auto range = find_time_range(clouds[c]))
            ranges.push_back({(*range)[0], (*range)[1], cloud_stamps_s[c], time_resolution(clouds[c])});
    return ranges;
}

/// Returns true if point times advance from cloud to cloud like the stamps.
bool follow_stamps(const std::vector<TimeRange>& ranges, double time_unit_s) {
    std::size_t n_like_stamps = 0;
    for (std::size_t k = 1; k < ranges.size(); ++k) {
        const double step_s = ranges[k].stamp_s - ranges[k - 1].stamp_s,
                     time_step_s = time_unit_s * (ranges[k].first - ranges[k - 1].first);
        n_like_stamps += std::abs(time_step_s - step_s) < 0.5 * std::abs(step_s);
    }
    return 2 * n_like_stamps + 1 > ranges.size();
}

/// Returns true if the first times of some clouds differ by more than a sweep. Then they
/// are no offsets from stamps, but for example times within a second.
bool first_times_differ(const std::vector<TimeRange>& ranges, double time_unit_s, double sweep_s) {
    std::vector<double> first_s;
    for (const TimeRange& range : ranges) first_s.push_back(range.first * time_unit_s);
    const double middle_s = compute_median(first_s);
    const auto n_near =
        std::ranges::count_if(first_s, [&](double t_s) { return std::abs(t_s - middle_s) <= sweep_s; });
    return double(n_near) < kMostClouds * double(ranges.size());
}

/// Returns what the point times of the clouds are relative to. A share of the clouds can
/// have wrong times, so only most of them must agree.
PointTimeReference find_time_reference(const std::vector<TimeRange>& ranges, double unit_s, double sweep_s) {
    const auto most = [&](auto test) {
        return double(std::ranges::count_if(ranges, test)) >= kMostClouds * double(ranges.size());
    };
    const auto are_close = [&](double first, double second) {
        return std::abs(first - second) <= kBesideStamp_s;
    };
    if (most([&](const TimeRange& r) {
            return are_close(r.first * unit_s, 0.0) && are_close(r.last * unit_s, 0.0);
        }) &&
        !follow_stamps(ranges, unit_s) && !first_times_differ(ranges, unit_s, sweep_s))
        return PointTimeReference::stamp;
    if (most([&](const TimeRange& r) {
            return are_close(r.first * unit_s, r.stamp_s) && are_close(r.last * unit_s, r.stamp_s);
        }))
        return PointTimeReference::epoch;
    return PointTimeReference::sensor_clock;
}

/// Returns true if the times are too coarse to resolve a sweep. Equal times of all points
/// are precise if they are close to the stamps, or if they are small.
bool are_times_coarse(const std::vector<TimeRange>& ranges, double span, double cloud_interval_s) {
    const TimeRange& cloud = ranges[ranges.size() / 2];
    if (span > 0.0) return is_coarse_time(cloud.resolution, span);
    const bool has_coarse_stamps = std::ranges::any_of(kTimeUnits, [&](const TimeUnit& unit) {
        const double resolution_s = cloud.resolution * unit.seconds;
        return is_coarse_time(resolution_s, cloud_interval_s) &&
               std::abs(cloud.first * unit.seconds - cloud.stamp_s) < kBesideStamp_s + resolution_s;
    });
    const bool is_clock = std::ranges::any_of(kTimeUnits, [&](const TimeUnit& unit) {
        return ranges.size() > 1 && follow_stamps(ranges, unit.seconds);
    });
    const bool is_constant = std::ranges::all_of(
        ranges, [&](const TimeRange& range) { return range.first == ranges.front().first; });
    return has_coarse_stamps ||
           (!is_clock && (cloud.resolution > kLargestStep ||
                          (!is_constant && is_coarse_time(cloud.resolution, cloud_interval_s))));
}

/// Sets the unit and the reference of the point times. Uses the first unit with which the
/// duration of a cloud is plausible (kMinTurns, kMaxTurns).
/// @param signed_ranges  the same times if large unsigned numbers are negative offsets
void set_time_unit(PointCloudUnits& units, const std::vector<TimeRange>& time_ranges,
                   const std::vector<TimeRange>& signed_ranges, double cloud_interval_s) {
    if (time_ranges.empty()) return;
    std::vector<double> spans;
    for (const TimeRange& r : time_ranges) spans.push_back(r.last - r.first);
    std::ranges::sort(spans);
    const double span = spans[spans.size() / 2];
    if (are_times_coarse(time_ranges, span, cloud_interval_s)) {
        const TimeRange& cloud = time_ranges[time_ranges.size() / 2];
        units.about = describe_coarse(cloud.last, cloud.resolution);
        return;
    }
    units.is_deskewed = spans.back() == 0.0;
    for (const TimeUnit& unit : kTimeUnits) {
        const double turns = span * unit.seconds / cloud_interval_s;
        if (!(turns >= kMinTurns && turns <= kMaxTurns)) continue;
        const double sweep_s = std::max({span * unit.seconds, cloud_interval_s, kLeastSweep_s});
        units.zero = find_time_reference(time_ranges, unit.seconds, sweep_s);
        if (units.zero == PointTimeReference::sensor_clock &&
            find_time_reference(signed_ranges, unit.seconds, sweep_s) == PointTimeReference::stamp)
            units.zero = PointTimeReference::stamp;
        units.time_unit_s = unit.seconds;
        units.about = fmt::format("the times of points are read in {}; {}; a cloud lasts {:.1f} ms",
                                  unit.name, kAboutZero[std::size_t(units.zero)], 1e3 * span * unit.seconds);
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

namespace fs = std::filesystem;

/// Reads the points of a few scans. Files of rays have no points and are left out.
std::vector<PointTable> sample_tables(const std::vector<fs::path>& scan_files,
                                      const std::vector<std::string>& column_names) {
    std::vector<fs::path> with_points = scan_files;
    if (!has_npz_points(scan_files))
        std::erase_if(with_points, [](const fs::path& file) { return !is_point_file(file); });
    std::vector<PointTable> samples;
    read_samples(with_points.size(),
                 [&](std::size_t i) { samples.push_back(read_point_file(with_points[i], column_names)); });
    return samples;
}

/// Reads the arrays "intensity" and "time" of a few .npz files with rays.
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

/// Ignores times that have lost their precision, with a note.
void drop_coarse_times(PointFileUnits& units, const std::vector<PointTable>& samples, Notes& notes) {
    constexpr double kTypicalSweep_s = 0.1;
    for (const PointTable& cloud : samples) {
        const auto range = find_time_range(cloud);
        if (!range || units.ignore_times) continue;
        const auto [first, last] = *range;
        const double resolution = time_resolution(cloud),
                     span = last > first ? last - first : kTypicalSweep_s / units.time_unit_s;
        units.ignore_times = is_coarse_time(resolution, span);
        if (units.ignore_times) notes.push_back(describe_coarse(last, resolution));
    }
}

}  // namespace

PointCloudUnits estimate_cloud_units(const std::vector<PointTable>& clouds,
                                     const std::vector<double>& cloud_stamps_s, double cloud_interval_s) {
    PointCloudUnits units;
    std::vector<PointTable> continuous_clouds = clouds;
    for (PointTable& cloud : continuous_clouds) unwrap_times(cloud, false);
    // Large unsigned times may be negative offsets, so both are compared.
    std::vector<PointTable> signed_clouds = continuous_clouds;
    std::ranges::for_each(signed_clouds, restore_signs);
    set_time_unit(units, list_time_ranges(continuous_clouds, cloud_stamps_s),
                  list_time_ranges(signed_clouds, cloud_stamps_s), cloud_interval_s);
    units.meaning = interpret_fields(continuous_clouds);
    if (!units.meaning.scale.about.empty()) units.meaning.notes.push_back(units.meaning.scale.about);
    return units;
}

void fill_units(PointFileUnits& units, const std::vector<fs::path>& scan_files, Notes& notes) {
    std::vector<PointTable> samples = sample_tables(scan_files, units.columns);
    for (PointTable& cloud : samples) unwrap_times(cloud, !units.absolute_times);
    PointFieldSemantics meaning = interpret_fields(samples);
    drop_coarse_times(units, samples, notes);
    if (samples.empty()) {
        // No file of points was read, so units are estimated from range images.
        const std::vector<PointTable> images = sample_images(scan_files);
        drop_coarse_times(units, images, notes);
        std::vector<double> intensities;
        for (const PointTable& image : images)
            if (const PointFieldView* field = image.find_field("intensity"))
                for (std::size_t i = 0; i < image.n; ++i) intensities.push_back((*field)[i]);
        if (!units.intensity_max) meaning.scale = estimate_scale(intensities);
    }
    units.intensity_field = meaning.intensity_field;
    units.no_return = meaning.no_return;
    units.returns = meaning.returns;
    if (!units.intensity_max && meaning.scale.is_sure && meaning.scale.max > 1.0) {
        units.intensity_max = meaning.scale.max;
        notes.push_back(meaning.scale.about +
                        "; set the key \"intensity_max\" in sequence.json to use another scale");
    }
    notes.insert(notes.end(), meaning.notes.begin(), meaning.notes.end());
}

}  // namespace relidar::read
