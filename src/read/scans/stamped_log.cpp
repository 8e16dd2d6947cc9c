// SPDX-License-Identifier: Apache-2.0
#include "read/scans/stamped_log.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <complex>

#include <relidar/log/log_time.hpp>
#include <relidar/read/clouds.hpp>

#include "base/csv.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/median.hpp"
#include "read/scans/cloud_units.hpp"
#include "read/scans/folder_points.hpp"
#include "read/scans/frame_range.hpp"
#include "read/scans/pose_files.hpp"

namespace relidar::read {
namespace {

namespace fs = std::filesystem;

// Minimum distance between poses from which the driving direction is computed. It is much
// larger than the errors of poses.
constexpr double kMinDrive_m = 1.0;
// If more time is between two poses, the motion between them is ignored.
constexpr double kLongestStep_s = 1.0;
// The points fit the nominal beams if their median distance from the beams is below this
// share of the beam spacing. Points of another LiDAR have about 0.25.
constexpr double kMaxBeamMisfit = 0.15;
// Tolerance for a pose at the requested time, relative to the time between poses.
constexpr double kSameTime = 1e-6;
// Maximum coordinate of a pose in metres. UTM coordinates are smaller (up to 10^7).
constexpr double kLargestCoordinate_m = 1e8;

/// Parses a line of a pose table: a time stamp and at least `n` numbers, of which the
/// first `n` are used.
/// @param where  file and line, for error messages
PoseRow parse_row(const std::vector<std::string_view>& cells, std::size_t n, const std::string& where) {
    std::optional<std::int64_t> stamp = parse_stamp(cells[0]);
    if (!stamp) {  // Some programs write time stamps with a fraction or an exponent.
        constexpr double kLargestStamp = 9e18;  // below the limit of 64 bits
        const std::optional<double> number = parse_number(cells[0]);
        if (number && *number >= 0.0 && *number < kLargestStamp) stamp = std::int64_t(std::llround(*number));
    }
    if (!stamp) fail("{}: found '{}', expected a time", where, quote(cells[0]));
    if (cells.size() < n + 1)
        fail("{}: found {} cells in the line, expected a time and {} numbers, separated by commas", where,
             cells.size(), n);
    PoseRow row{.stamp = *stamp, .values = {}, .where = where};
    for (std::size_t c = 1; c <= n; ++c) {
        const std::optional<double> number = parse_number(cells[c]);
        if (!number || !(std::abs(*number) <= kLargestCoordinate_m))
            fail("{}: cell {} is '{}', expected a number from {:g} to {:g}", where, c + 1, quote(cells[c]),
                 -kLargestCoordinate_m, kLargestCoordinate_m);
        row.values.push_back(*number);
    }
    return row;
}

/// Returns the interpolated pose at a time. Returns nothing near the ends of the poses,
/// or in a gap between poses that is too long, except at its ends.
std::optional<Pose> find_pose(const StampedLog& stamped, double time_s) {
    const PoseTrack& track = stamped.world_from_vehicle;
    if (!track.contains_time(time_s - stamped.pose_margin_s) ||
        !track.contains_time(time_s + stamped.pose_margin_s))
        return std::nullopt;
    const TrackInterpolation between = track.find_segment(time_s);
    const bool is_at_pose = between.s < kSameTime || between.s > 1.0 - kSameTime;
    if (is_at_pose) return track.pose_at(time_s);
    const double gap_s = track.time_s[between.left + 1] - track.time_s[between.left];
    return gap_s > stamped.most_gap_s ? std::nullopt : std::optional(track.pose_at(time_s));
}

/// Reads point files in relidar's axes. Adds missing values such as rings.
class StampedScans : public ScanProvider {
public:
    StampedScans(const Log& log, const std::vector<fs::path>& files, const FileFormat& format)
        : log_(log), files_(files), format_(format) {}

    std::string frame_name(std::size_t index) const override { return files_[index].string(); }
    LidarPoints read_points(std::size_t index) const override {
        PointTable table = read_point_file(files_[index], format_.units.columns);
        if (format_.complete) format_.complete(table, frame_name(index));
        LidarPoints points =
            convert_table(table, format_.units, log_.frames[index].time_s, frame_name(index));
        // Rotates the points about z, from the axes of the files to relidar's axes.
        const double c = std::cos(format_.turned_rad), s = std::sin(format_.turned_rad);
        for (glm::vec3& p : points.position_m) {
            const glm::dvec3 in_file(p);
            p = glm::vec3(c * in_file.x - s * in_file.y, s * in_file.x + c * in_file.y, in_file.z);
        }
        if (!format_.beams.empty()) assign_rings(points, format_.beams);
        return points;
    }

private:
    const Log& log_;
    const std::vector<fs::path>& files_;
    const FileFormat& format_;
};

/// Returns the angle from a beam to the nearest other beam.
/// @param beams  sorted by elevation
double angle_to_next_beam(const std::vector<Beam>& beams, std::size_t beam) {
    const auto angle_to = [&](std::size_t other) {  // an index below 0 wraps around
        return other < beams.size() ? std::abs(beams[other].elevation_rad - beams[beam].elevation_rad)
                                    : INFINITY;
    };
    return std::min(angle_to(beam - 1), angle_to(beam + 1));
}

/// Returns true if most points are close to the nominal beams in elevation, compared with
/// the beam spacing. Returns false for points of another LiDAR.
bool match_beams(const std::vector<LidarPoints>& sample_scans, const FittedSensor& fitted_sensor) {
    const std::vector<Beam>& beams = fitted_sensor.sensor.beams;
    std::vector<double> misfits;  // angle between a point and its beam, divided by the angle to the next beam
    for (const LidarPoints& scan : sample_scans)
        for (std::size_t i = 0; i < scan.size(); ++i) {
            const std::size_t beam = fitted_sensor.beam_of_ring[scan.ring[i]];
            const glm::dvec3 p(scan.position_m[i]);
            const double elevation_rad = std::atan2(p.z, std::hypot(p.x, p.y));
            misfits.push_back(std::abs(elevation_rad - beams[beam].elevation_rad) /
                              angle_to_next_beam(beams, beam));
        }
    return compute_median(std::move(misfits)) < kMaxBeamMisfit;
}

/// Returns the mean of angles that are known only up to multiples of 2 pi / n.
double mean_modulo(const std::vector<double>& angles_rad, int n) {
    std::complex<double> sum = 0.0;
    for (const double angle_rad : angles_rad) sum += std::polar(1.0, n * angle_rad);
    return std::arg(sum) / n;
}

/// Corrects the elevations and the azimuth offsets of the nominal beams by a fit. Azimuth
/// offsets change by less than a column, because the fit cannot detect full columns. A
/// change that all beams share is the start of the columns, and is ignored.
/// @param nominal_beams  [rings] beams of the data sheet
std::vector<Beam> adjust_beams(const std::vector<Beam>& nominal_beams, const FittedSensor& fit) {
    std::vector<Beam> beams = nominal_beams;
    std::vector<Beam*> found;         // beams that the fit has
    std::vector<double> changes_rad;  // [found] of the azimuth offset
    for (std::size_t ring = 0; ring < std::min(beams.size(), fit.beam_of_ring.size()); ++ring) {
        if (fit.beam_of_ring[ring] == kNoBeam) continue;
        const Beam& fitted_beam = fit.sensor.beams[fit.beam_of_ring[ring]];
        beams[ring].elevation_rad = fitted_beam.elevation_rad;
        found.push_back(&beams[ring]);
        changes_rad.push_back(fitted_beam.azimuth_offset_rad - beams[ring].azimuth_offset_rad);
    }
    const double column_rad = 2.0 * kPi / fit.sensor.columns;
    const double shared_rad = mean_modulo(changes_rad, fit.sensor.columns);
    for (std::size_t k = 0; k < found.size(); ++k)
        found[k]->azimuth_offset_rad += std::remainder(changes_rad[k] - shared_rad, column_rad);
    return beams;
}

/// Returns a sensor with the beams in `format`, fitted to the points of a few scans.
/// Returns nothing if the points come from another LiDAR. Also returns nothing if their
/// azimuths are not on a regular grid, for example after motion compensation.
std::optional<SpinningSensor> fit_nominal(const StampedScans& source, std::size_t n_scans,
                                          const FileFormat& format) {
    std::vector<LidarPoints> scans;
    read_samples(n_scans, [&](std::size_t i) {
        if (LidarPoints points = source.read_points(i); points.size() > 0) scans.push_back(std::move(points));
    });
    if (scans.empty()) return std::nullopt;
    FittedSensor fit;
    try {
        fit = fit_spinning_sensor(scans, format.sweep_duration_s);
    } catch (const DataError&) {
        return std::nullopt;
    }
    if (!match_beams(scans, fit)) return std::nullopt;
    fit.sensor.beams = adjust_beams(format.beams, fit);
    return fit.sensor;
}

/// Adds a note about scans that are skipped because they have no pose.
/// @param without_pose  at least one scan
/// @throws DataError if no scan has a pose
void note_without_pose(Log& log, const StampedLog& stamped,
                       const std::vector<const StampedScanFile*>& without_pose, std::size_t n_with_pose) {
    const StampedScanFile &first = *without_pose.front(), &last = *without_pose.back();
    const PoseTrack& poses = stamped.world_from_vehicle;
    if (n_with_pose == 0)
        fail(
            "{}: found poses from {:.3f} to {:.3f} s, expected poses near the times of frames {} to {}, "
            "which are {:.3f} to {:.3f} s",
            stamped.poses_file.string(), poses.time_s.front(), poses.time_s.back(), first.number, last.number,
            stamped.seconds_of(first.stamp), stamped.seconds_of(last.stamp));
    log.notes.push_back(
        fmt::format("{} of {} scans are skipped (the first is frame {}, the last frame {}), because {} "
                    "has no poses near their times",
                    without_pose.size(), without_pose.size() + n_with_pose, first.number, last.number,
                    stamped.poses_file.filename().string()));
}

}  // namespace

std::optional<std::int64_t> parse_stamp(std::string_view text) {
    std::int64_t stamp = 0;
    const auto [end, failed] = std::from_chars(text.data(), text.data() + text.size(), stamp);
    if (failed != std::errc() || end != text.data() + text.size() || stamp < 0) return std::nullopt;
    return stamp;
}

std::vector<StampedScanFile> list_stamped_files(const fs::path& folder, const std::string& extension) {
    std::vector<StampedScanFile> scans;
    for (const fs::path& file : list_folder(folder)) {
        const std::optional<std::int64_t> stamp = parse_stamp(file.stem().string());
        if (stamp && file.extension() == extension) scans.push_back({.stamp = *stamp, .file = file});
    }
    if (scans.empty())
        fail("{}: no scan was found, expected files named by their times, such as 1598990189106857{}",
             folder.string(), extension);
    // Sorts by the number, because sorting by name would put "10" before "9".
    std::ranges::sort(scans, {}, &StampedScanFile::stamp);
    for (std::size_t i = 0; i < scans.size(); ++i) scans[i].number = int(i);
    return scans;
}

std::vector<PoseRow> read_stamped_rows(const fs::path& file, std::size_t min_values_per_row) {
    const std::vector<std::string> lines = split_lines(read_text_file(file));
    std::vector<PoseRow> rows;
    std::size_t n_cells_before = 0;  // number of cells in the line before
    for (std::size_t l = 0; l < lines.size(); ++l) {
        if (trim(lines[l]).empty()) continue;
        const std::vector<std::string_view> cells = split_csv_cells(lines[l]);
        const bool has_column_names = l == 0 && !parse_number(cells[0]);
        if (has_column_names) continue;
        PoseRow row = parse_row(cells, min_values_per_row, fmt::format("{} line {}", file.string(), l + 1));
        if (cells.size() < n_cells_before)  // for example a line that was written partly
            fail("{}: found {} cells in the line, expected {} as in the line before", row.where, cells.size(),
                 n_cells_before);
        n_cells_before = cells.size();
        if (!rows.empty() && row.stamp == rows.back().stamp) continue;
        if (!rows.empty() && row.stamp < rows.back().stamp)
            fail("{}: found the time {} after {}, expected increasing times", row.where, row.stamp,
                 rows.back().stamp);
        rows.push_back(std::move(row));
    }
    if (rows.empty())
        fail("{}: no pose was found, expected lines with a time and {} numbers", file.string(),
             min_values_per_row);
    return rows;
}

DrivingDirection driving_direction(const PoseTrack& world_from_sensor) {
    const std::vector<Pose>& poses = world_from_sensor.pose;
    DrivingDirection driving;
    double sum_of_squares = 0.0;  // of the z components
    std::size_t from = 0;         // pose at which the present step begins
    for (std::size_t to = 1; to < poses.size(); ++to) {
        if (world_from_sensor.time_s[to] - world_from_sensor.time_s[from] > kLongestStep_s) {
            from = to;  // The step took too long, so its motion is ignored.
            continue;
        }
        const glm::dvec3 step_m = poses[to].translation - poses[from].translation;
        if (glm::length(step_m) < kMinDrive_m) continue;  // The step continues to the next pose.
        // Mean of the directions in both sensor frames, because the sensor rotates
        // between the poses in a curve.
        const glm::dvec3 direction = glm::normalize(step_m);
        const glm::dvec3 direction_in_sensor = 0.5 * (glm::conjugate(poses[from].rotation) * direction +
                                                      glm::conjugate(poses[to].rotation) * direction);
        driving.mean += direction_in_sensor;
        sum_of_squares += direction_in_sensor.z * direction_in_sensor.z;
        ++driving.n_steps;
        from = to;
    }
    if (driving.n_steps == 0) return driving;
    driving.mean /= double(driving.n_steps);
    const double variance = sum_of_squares / double(driving.n_steps) - driving.mean.z * driving.mean.z;
    driving.rise_spread = std::sqrt(std::max(0.0, variance));
    return driving;
}

void note_driving(Notes& notes, double forward_fraction) {
    constexpr double kMostlyForward = 0.9;
    if (forward_fraction < kMostlyForward)
        notes.push_back(fmt::format(
            "poses: on average, the vehicle moves only {:.2f} m along its forward axis per metre of its "
            "path, expected nearly 1 m; use dataset.poses=none to estimate the poses from the scans",
            forward_fraction));
}

std::vector<fs::path> add_frames(Log& log, const StampedLog& stamped, const DatasetOptions& options) {
    const FrameRange& range = options.frames;
    std::vector<fs::path> files;
    std::vector<const StampedScanFile*> without_pose;
    for (const StampedScanFile& scan : stamped.scans) {
        if (!range.contains(scan.number)) continue;
        const double time_s = stamped.seconds_of(scan.stamp);
        // The user's poses are set by replace_poses() below.
        const std::optional<Pose> pose = options.poses_file.empty() ? find_pose(stamped, time_s) : Pose{};
        if (pose) {
            add_frame(log, scan.number, time_s, *pose);
            files.push_back(scan.file);
        } else {
            without_pose.push_back(&scan);
        }
    }
    if (files.empty() && without_pose.empty())
        fail_empty_range(range, log.name, stamped.scans.front().number, stamped.scans.back().number);
    if (!without_pose.empty()) note_without_pose(log, stamped, without_pose, files.size());
    set_log_start(log, stamped.scans[0].stamp * std::llround(1e9 * stamped.unit_s),
                  "on the clock of the files");
    read::replace_poses(log, options);
    centre_log(log);
    return files;
}

void check_pose_source(const fs::path& pose_file, const DatasetOptions& options) {
    if (!options.poses_file.empty() || does_path_exist(pose_file)) return;
    fail("{}: no such file; expected poses; use dataset.poses=FILE or dataset.poses=none",
         pose_file.string());
}

void read_frame_scans(Log& log, const std::vector<fs::path>& scan_files, FileFormat format,
                      const DatasetOptions& options) {
    ScanLayout layout{.lidars = {{.sweep_duration_s = format.sweep_duration_s}}};
    if (!format.beams.empty()) {
        std::optional<SpinningSensor> fitted =
            fit_nominal(StampedScans(log, scan_files, format), scan_files.size(), format);
        if (fitted) {
            SpinningSensor& sensor = log.lidars[0].sensor;
            fitted->name = sensor.name;
            fitted->max_range_m = sensor.max_range_m;
            sensor = std::move(*fitted);
            layout.lidars[0].has_beams = true;
            log.notes.push_back(
                fmt::format("a sensor with {} beams and {} columns was fitted to the points, which have no "
                            "rings; each point is assigned to the nominal beam with the nearest elevation",
                            sensor.beams.size(), sensor.columns));
        } else {
            format.beams.clear();  // The points come from another LiDAR and get no rings.
        }
    }
    apply_conventions(log, layout, options.conventions);
    if (options.conventions.intensity_max > 0.0) {
        format.units.intensity_max = options.conventions.intensity_max;
        list_scale(log, {options.conventions.intensity_max, true, kFromSetting}, "");
    }
    read_scans(log, layout, StampedScans(log, scan_files, format), options);
}

void set_intensity_max(FileFormat& format, Log& log, const std::vector<fs::path>& scan_files) {
    std::vector<PointTable> samples;
    read_samples(scan_files.size(),
                 [&](std::size_t i) { samples.push_back(read_point_file(scan_files[i], {})); });
    const IntensityScale scale = interpret_fields(samples).scale;
    format.units.intensity_max = scale.max;
    list_scale(log, scale, "");
}

}  // namespace relidar::read
