// SPDX-License-Identifier: Apache-2.0
#include "log/clouds/stamped_log.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <complex>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/log/clouds.hpp>

#include "base/csv.hpp"
#include "base/files.hpp"
#include "base/median.hpp"
#include "log/clouds/folder_points.hpp"
#include "log/clouds/log_files.hpp"
#include "log/clouds/point_meaning.hpp"

namespace relidar::stamped {
namespace {

namespace fs = std::filesystem;

// The driving direction is computed from poses that are at least this far apart. Errors
// of poses are much smaller.
constexpr double kStep_m = 1.0;
// Between poses with a longer time difference, the motion is unknown and is ignored.
constexpr double kLongestStep_s = 1.0;
constexpr std::size_t kSamples = 6;  // number of scans for estimates
// The points fit the nominal beams if their median distance from the beams is below this
// share of the beam spacing. For another LiDAR, this share is about 0.25.
constexpr double kNearBeam = 0.15;
// A pose at almost the requested time is used without interpolation. This tolerance is
// relative to the time between poses.
constexpr double kSameTime = 1e-6;
// Maximum coordinate of a pose in metres. UTM coordinates are smaller (up to 10^7).
constexpr double kLargestCoordinate_m = 1e8;

/// Parses a time stamp in a table. Some programs write time stamps with a fraction or an
/// exponent.
std::optional<std::int64_t> parse_stamp_cell(std::string_view cell) {
    if (const auto whole = parse_timestamp_ns(cell)) return whole;
    const std::optional<double> number = parse_number(cell);
    if (!number || !(*number >= 0.0 && *number < 9e18)) return std::nullopt;
    return std::int64_t(std::llround(*number));
}

StampedRow parse_row(const std::vector<std::string_view>& cells, std::size_t n_values,
                     const std::string& location) {
    StampedRow row{0, {}, location};
    const std::optional<std::int64_t> stamp = parse_stamp_cell(cells[0]);
    if (!stamp)
        throw DataError(fmt::format("{}: found '{}', expected a time", location, make_excerpt(cells[0])));
    row.stamp = *stamp;
    if (cells.size() < n_values + 1)
        throw DataError(fmt::format("{}: found {} cells, expected a time and {} numbers", location,
                                    cells.size(), n_values));
    for (std::size_t c = 1; c <= n_values; ++c) {
        const std::optional<double> number = parse_number(cells[c]);
        if (!number || !(std::abs(*number) <= kLargestCoordinate_m))
            throw DataError(fmt::format("{}: cell {} is '{}', expected a number of at most {:g}", location,
                                        c + 1, make_excerpt(cells[c]), kLargestCoordinate_m));
        row.values.push_back(*number);
    }
    return row;
}

std::optional<Pose> pose_at(const StampedLog& log, double time_s) {
    const PoseTrack& track = log.world_from_vehicle;
    if (!track.covers(time_s - log.reach_s) || !track.covers(time_s + log.reach_s)) return std::nullopt;
    const TrackPosition place = track.place(time_s);
    const bool is_one = place.s < kSameTime || place.s > 1.0 - kSameTime;
    if (!is_one && track.time_s[place.left + 1] - track.time_s[place.left] > log.most_gap_s)
        return std::nullopt;
    return track.at(time_s);
}

/// Reads point files. Adds missing values such as rings, and rotates the points to
/// relidar's axes.
class StampedPoints : public folder::ScanSource {
public:
    StampedPoints(const Sequence& sequence, const std::vector<fs::path>& files, const PointFormat& format)
        : sequence_(sequence), files_(files), format_(format) {}

    std::string name(std::size_t index) const override { return files_[index].string(); }
    bool has_points(std::size_t) const override { return true; }
    Points points(std::size_t index) const override {
        folder::PointTable table = folder::read_point_file(files_[index], format_.units.columns);
        if (format_.complete) format_.complete(table, name(index));
        Points points =
            folder::make_points(table, format_.units, sequence_.frames[index].time_s, name(index));
        const double c = std::cos(format_.turned_rad), s = std::sin(format_.turned_rad);
        for (glm::vec3& p : points.position_m) {
            const glm::dvec3 own(p);
            p = glm::vec3(c * own.x - s * own.y, s * own.x + c * own.y, own.z);
        }
        if (!format_.beams.empty()) recover_rings(points, format_.beams);
        return points;
    }
    Scan rays(std::size_t index) const override {
        throw DataError(fmt::format("{}: the scan has no points, expected at least one", name(index)));
    }

private:
    const Sequence& sequence_;
    const std::vector<fs::path>& files_;
    const PointFormat& format_;
};

/// Reads the points of a few scans. Skips scans that cannot be read.
std::vector<Points> sample_points(const StampedPoints& source, std::size_t n_scans) {
    std::vector<Points> samples;
    const std::size_t n = std::min(kSamples, n_scans);
    for (std::size_t k = 0; k < n; ++k) {
        try {
            samples.push_back(source.points(k * n_scans / n));
            if (samples.back().size() == 0) samples.pop_back();
        } catch (const DataError&) {
            continue;  // the error is reported when the scan is read
        }
    }
    return samples;
}

/// Returns true if the elevations of most points are close to those of the nominal beams,
/// compared with the spacing of the beams. Returns false for points of another LiDAR.
bool are_points_near_beams(const std::vector<Points>& samples, const FittedSensor& fit) {
    const std::vector<Beam>& beams = fit.sensor.beams;
    // angle between each point and its beam, divided by the angle to the next beam
    std::vector<double> off;
    for (const Points& scan : samples)
        for (std::size_t i = 0; i < scan.size(); ++i) {
            const std::size_t b = fit.beam_of_ring[scan.ring[i]];
            double apart = INFINITY;
            // b - 1 is a very large, invalid index if b is 0
            for (const std::size_t next : {b - 1, b + 1})
                if (next < beams.size())
                    apart = std::min(apart, std::abs(beams[next].elevation_rad - beams[b].elevation_rad));
            const glm::dvec3 p(scan.position_m[i]);
            off.push_back(std::abs(std::atan2(p.z, std::hypot(p.x, p.y)) - beams[b].elevation_rad) / apart);
        }
    return compute_median(std::move(off)) < kNearBeam;
}

/// Fits the nominal beams to the points. Returns nothing if the points come from another
/// LiDAR, or if their azimuths are not on a regular grid, for example after motion
/// compensation.
std::optional<SpinningSensor> fit_nominal(const std::vector<Points>& samples, const PointFormat& format) {
    if (samples.empty()) return std::nullopt;
    FittedSensor fit;
    try {
        fit = fit_sensor(samples, format.turn_s);
    } catch (const DataError&) {
        return std::nullopt;
    }
    if (!are_points_near_beams(samples, fit)) return std::nullopt;
    const double step = 2.0 * kPi / fit.sensor.columns;
    std::vector<Beam> beams = format.beams;
    std::complex<double> sum = 0.0;
    // The first pass fits an azimuth offset that all beams share. The second pass fits an
    // offset for each beam.
    for (const bool is_second : {false, true})
        for (std::size_t r = 0; r < std::min(beams.size(), fit.beam_of_ring.size()); ++r) {
            if (fit.beam_of_ring[r] == kNoBeam) continue;
            const Beam& found = fit.sensor.beams[fit.beam_of_ring[r]];
            const double beside = found.azimuth_offset_rad - format.beams[r].azimuth_offset_rad;
            if (!is_second) sum += std::polar(1.0, fit.sensor.columns * beside);
            else
                beams[r].azimuth_offset_rad +=
                    std::remainder(beside - std::arg(sum) / fit.sensor.columns, step);
            beams[r].elevation_rad = found.elevation_rad;
        }
    fit.sensor.beams = std::move(beams);
    return fit.sensor;
}

}  // namespace

std::optional<std::int64_t> parse_timestamp_ns(std::string_view text) {
    std::int64_t stamp = 0;
    const auto [end, failed] = std::from_chars(text.data(), text.data() + text.size(), stamp);
    if (failed != std::errc() || end != text.data() + text.size() || stamp < 0) return std::nullopt;
    return stamp;
}

std::vector<StampedScan> list_scans(const fs::path& folder) {
    std::vector<StampedScan> scans;
    for (const fs::path& file : list_folder(folder))
        if (const auto stamp = parse_timestamp_ns(file.stem().string()); stamp && file.extension() == ".bin")
            scans.push_back({0, *stamp, file});
    if (scans.empty())
        throw DataError(
            fmt::format("{}: no scan was found, expected files named by their times, such as "
                        "1598990189106857.bin",
                        folder.string()));
    // Sorts by the number, because sorting by name would put "10" before "9".
    std::ranges::sort(scans, {}, &StampedScan::stamp);
    for (std::size_t i = 0; i < scans.size(); ++i) scans[i].number = int(i);
    return scans;
}

std::vector<StampedRow> read_rows(const fs::path& file, std::size_t n_values) {
    const std::vector<std::string> lines = split_lines(read_text(file));
    std::vector<StampedRow> rows;
    for (std::size_t l = 0; l < lines.size(); ++l) {
        if (trim_spaces(lines[l]).empty()) continue;
        const std::vector<std::string_view> cells = split_csv_cells(lines[l]);
        if (l == 0 && !parse_number(cells[0])) continue;  // skips a first line with column names
        StampedRow row = parse_row(cells, n_values, fmt::format("{} line {}", file.string(), l + 1));
        if (!rows.empty() && row.stamp == rows.back().stamp) continue;
        if (!rows.empty() && row.stamp < rows.back().stamp)
            throw DataError(fmt::format("{}: found the time {} after {}, expected increasing times",
                                        row.where, row.stamp, rows.back().stamp));
        rows.push_back(std::move(row));
    }
    if (rows.empty())
        throw DataError(fmt::format("{}: no pose was found, expected lines with a time and {} numbers",
                                    file.string(), n_values));
    return rows;
}

Driving estimate_driving_direction(const PoseTrack& world_from_rider) {
    const std::vector<Pose>& poses = world_from_rider.pose;
    Driving driving;
    double rises = 0.0;
    for (std::size_t from = 0, to = 1; to < poses.size(); ++to) {
        const glm::dvec3 step = poses[to].translation - poses[from].translation;
        const bool is_late = world_from_rider.time_s[to] - world_from_rider.time_s[from] > kLongestStep_s;
        if (!is_late && glm::length(step) < kStep_m) continue;
        // In a curve, the motion has different directions in the first and the last
        // sensor frame. Their mean is used.
        if (!is_late) {
            const glm::dvec3 d = glm::normalize(step);
            const glm::dvec3 seen =
                0.5 * (glm::conjugate(poses[from].rotation) * d + glm::conjugate(poses[to].rotation) * d);
            driving.mean += seen;
            rises += seen.z * seen.z;
            ++driving.n_steps;
        }
        from = to;
    }
    if (driving.n_steps == 0) return driving;
    driving.mean /= double(driving.n_steps);
    driving.rise_spread =
        std::sqrt(std::max(0.0, rises / double(driving.n_steps) - driving.mean.z * driving.mean.z));
    return driving;
}

void warn_unless_facing_forward(std::vector<std::string>& notes, double forward) {
    constexpr double kMostlyForward = 0.9;
    if (forward < kMostlyForward)
        notes.push_back(
            fmt::format("poses: the vehicle drives forward only {:.2f} m per metre on average, expected "
                        "nearly 1; use dataset.poses=none to estimate the poses from the scans",
                        forward));
}

std::vector<fs::path> add_frames(Sequence& sequence, const StampedLog& log, const DatasetOptions& options) {
    const FrameRange& range = options.frames;
    std::vector<fs::path> files;
    std::vector<const StampedScan*> without;
    for (const StampedScan& scan : log.scans) {
        if (scan.number < range.begin || (range.end >= 0 && scan.number >= range.end)) continue;
        const double time_s = log.seconds(scan.stamp);
        const std::optional<Pose> pose = options.poses_file.empty() ? pose_at(log, time_s) : Pose{};
        if (!pose) {
            without.push_back(&scan);
            continue;
        }
        add_frame(sequence, scan.number, time_s, *pose);
        files.push_back(scan.file);
    }
    if (files.empty() && without.empty())
        throw UsageError(fmt::format("frames {}:{} select no scan of {}, expected numbers in [{}, {}]",
                                     range.begin, range.end, sequence.name, log.scans.front().number,
                                     log.scans.back().number));
    if (files.empty())
        throw DataError(fmt::format(
            "{}: found poses from {:.3f} to {:.3f} s, expected poses near the times of frames {} to {}, "
            "which are {:.3f} to {:.3f} s",
            log.poses_file.string(), log.world_from_vehicle.time_s.front(),
            log.world_from_vehicle.time_s.back(), without.front()->number, without.back()->number,
            log.seconds(without.front()->stamp), log.seconds(without.back()->stamp)));
    if (!without.empty())
        sequence.notes.push_back(fmt::format(
            "{} of {} scans are skipped (the first is frame {}, the last frame {}), because {} has no "
            "poses near their times",
            without.size(), without.size() + files.size(), without.front()->number, without.back()->number,
            log.poses_file.filename().string()));
    kitti::use_pose_file(sequence, options.poses_file);
    recentre_sequence(sequence);
    return files;
}

void check_poses(const fs::path& file, const DatasetOptions& options) {
    if (!options.poses_file.empty() || does_path_exist(file)) return;
    throw DataError(
        fmt::format("{}: no such file; expected poses; use dataset.poses=FILE to name another file, or "
                    "dataset.poses=none to estimate the poses from the scans",
                    file.string()));
}

void read_points(Sequence& sequence, const std::vector<fs::path>& files, PointFormat format,
                 const DatasetOptions& options) {
    const StampedPoints source(sequence, files, format);
    SpinningSensor& sensor = sequence.lidars[0].sensor;
    folder::Head head;
    folder::HeadLidar& of_head = head.lidars.emplace_back();
    if (!format.beams.empty()) {
        if (auto fitted = fit_nominal(sample_points(source, files.size()), format)) {
            fitted->name = sensor.name;
            fitted->max_range_m = sensor.max_range_m;
            sensor = std::move(*fitted);
            of_head.has_beams = true;
            sequence.notes.push_back(fmt::format(
                "a sensor with {} beams and {} columns was fitted to the points, which have no rings; each "
                "point is assigned to the nominal beam with the nearest elevation",
                sensor.beams.size(), sensor.columns));
        } else {
            // `source` reads `format`, so clearing the beams makes it return points
            // without rings.
            format.beams.clear();
        }
    }
    head.name = sequence.name;
    head.units = format.units;
    of_head.lidar = sequence.lidars[0];
    of_head.is_guessed = true;
    of_head.turn_s = format.turn_s;
    folder::read_scans(sequence, head, source, options);
}

Brightness find_brightness(const std::vector<fs::path>& files, const std::vector<std::string>& columns) {
    std::vector<folder::PointTable> samples;
    const std::size_t n = std::min(kSamples, files.size());
    for (std::size_t k = 0; k < n; ++k) {
        try {
            samples.push_back(folder::read_point_file(files[k * files.size() / n], columns));
        } catch (const DataError&) {
            continue;  // the error is reported when the scan is read
        }
    }
    const folder::IntensityScale scale = folder::find_meaning(samples).scale;
    return {scale.max, scale.about};
}

}  // namespace relidar::stamped
