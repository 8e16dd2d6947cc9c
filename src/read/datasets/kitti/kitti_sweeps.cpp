// SPDX-License-Identifier: Apache-2.0
// Reconstructs the rays of an HDL-64E from KITTI scans. The order of points in the file
// gives the rings. Beam elevations and firing angles are fitted to the points. Then each
// point is assigned to its ray. Rays without a point are dropped rays.
#include "read/datasets/kitti/kitti_sweeps.hpp"

#include <algorithm>
#include <cmath>
#include <optional>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>
#include <relidar/read/clouds.hpp>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/median.hpp"
#include "base/parallel.hpp"
#include "base/progress_blocks.hpp"
#include "read/datasets/kitti/firing_lattice.hpp"
#include "read/datasets/kitti/log_files.hpp"
#include "read/files/point_table.hpp"
#include "read/files/scan_npz.hpp"
#include "read/scans/broken_scans.hpp"
#include "read/scans/cloud_units.hpp"
#include "read/scans/fired_sweeps.hpp"
#include "read/scans/firing_recovery.hpp"
#include "read/scans/folder_points.hpp"
#include "read/scans/point_meaning.hpp"
#include "read/scans/scan_plan.hpp"

namespace relidar::kitti {
namespace {

// scans to which elevations are fitted, and to which the grid of firings is fitted
constexpr std::size_t kFitScans = 6, kLatticeScans = 3;

/// Returns at most `most` scans, evenly spread over the log.
std::vector<const RingScan*> pick_scans(const std::vector<RingScan>& scans, std::size_t most) {
    std::vector<const RingScan*> some;
    for (const std::size_t i : read::spread_indices(scans.size(), most)) some.push_back(&scans[i]);
    return some;
}

/// Corrects the ring numbers of all scans. Returns the cones of the beams.
BeamCones correct_all_rings(std::vector<RingScan>& scans, const std::string& where) {
    const BeamCones cones = fit_ring_cones(pick_scans(scans, kFitScans), where);
    parallel_for(int(scans.size()), [&](int index) { correct_rings(scans[std::size_t(index)], cones); });
    return cones;
}

/// Moves the points of motion-compensated scans back to their firing times, if they show
/// how the head turned. Adds a note and sets the rolling shutter then.
std::optional<read::FiringRecovery> recover_sweeps(Log& log, std::vector<RingScan>& scans,
                                                   const std::string& scan_folder, bool has_poses) {
    // find_firings() needs rings. Compensation moves points by less than the distance
    // between beams, so they are good enough now. The caller corrects them again.
    correct_all_rings(scans, scan_folder);
    std::vector<read::CompensatedSweep> samples;
    for (const std::size_t i : read::spread_indices(scans.size(), kFitScans))
        if (scans[i].is_complete()) samples.push_back({scans[i].points, log.frames[i].time_s});
    read::CompensatedSensor sensor{.period_s = read::estimate_sweep_s(log, 0), .n_ticks = kEncoderTicks};
    if (has_poses) sensor.world_from_sensor = log.lidar_track(0);
    const std::optional<read::FiringRecovery> recovery = read::find_firings(samples, sensor);
    if (!recovery) return recovery;
    parallel_for(int(scans.size()), [&](int index) {
        const auto i = std::size_t(index);
        read::restore_firings(scans[i].points, *recovery, log.frames[i].time_s);
    });
    log.rolling_shutter = true;
    log.lidars[0].sensor.period_s = sensor.period_s;
    log.lidars[0].sensor.clockwise = recovery->turn.clockwise;
    log.notes.push_back(read::describe_recovery(*recovery));
    return recovery;
}

/// Returns the azimuth of the last point of a scan, from 0 to 360 degrees. In each ring,
/// azimuths increase from 0, so a complete scan ends near 360.
double last_azimuth_deg(const RingScan& scan) {
    if (scan.points.size() == 0) return 0.0;
    // With more than 64 rings, the 64th ring is complete.
    if (scan.n_rings > kRings) return 360.0;
    const glm::dvec3 last(scan.points.position_m.back());
    const double azimuth_deg = std::atan2(last.y, last.x) * 180.0 / kPi;
    return azimuth_deg < 0.0 ? azimuth_deg + 360.0 : azimuth_deg;
}

/// What a truncated file lacks: points, rings, or the end of the last ring.
struct ScanExtent {
    double n_points = 0.0, n_rings = 0.0, end_deg = 0.0;
};

/// Returns the median extent of up to five scans before and five after a scan. Ignores
/// values of 0, which unreadable scans have. Without others, returns the scan's own.
ScanExtent median_extent(const std::vector<ScanExtent>& extents, std::size_t scan_index) {
    constexpr std::size_t kNeighboursPerSide = 5;
    const std::size_t begin = scan_index < kNeighboursPerSide ? 0 : scan_index - kNeighboursPerSide,
                      end = std::min(extents.size(), scan_index + kNeighboursPerSide + 1);
    const auto median = [&](double ScanExtent::*value) {
        std::vector<double> neighbours;
        for (std::size_t k = begin; k < end; ++k)
            if (k != scan_index && extents[k].*value > 0.0) neighbours.push_back(extents[k].*value);
        return neighbours.empty() ? extents[scan_index].*value : compute_median(std::move(neighbours));
    };
    return {median(&ScanExtent::n_points), median(&ScanExtent::n_rings), median(&ScanExtent::end_deg)};
}

/// Records scans that are much smaller than the scans before and after them, because the
/// points that a damaged file lacks are no dropped rays.
/// @param name_of  returns the name of a scan
template <class Name>
void record_truncated(const std::vector<RingScan>& scans, const Name& name_of, ScanErrorCollector& broken) {
    // One missing ring is accepted, because it can be a beam without returns.
    constexpr double kMissingRings = 2.0;
    // In complete scans, the azimuth of the last point varies by up to 20 degrees.
    constexpr double kMissingTurn_deg = 60.0;
    std::vector<ScanExtent> extents;
    for (const RingScan& scan : scans)
        extents.push_back({double(scan.points.size()), double(scan.n_rings), last_azimuth_deg(scan)});
    for (std::size_t i = 0; i < scans.size(); ++i) {
        const ScanExtent &scan = extents[i], usual = median_extent(extents, i);
        const bool has_half_of_points = scan.n_points > 0.0 && 2.0 * scan.n_points >= usual.n_points;
        const bool is_complete = has_half_of_points && scan.n_rings + kMissingRings > usual.n_rings &&
                                 scan.end_deg + kMissingTurn_deg > usual.end_deg;
        if (!is_complete && !broken.is_scan_broken(i))
            broken.record_broken(
                i,
                fmt::format("{}: the scan has {} points in {} rings and ends at azimuth {:.0f} degrees, but "
                            "neighbouring scans have {} points in {} rings and end at {:.0f} degrees; the "
                            "file is probably truncated or damaged",
                            name_of(i), scan.n_points, scan.n_rings, scan.end_deg, usual.n_points,
                            usual.n_rings, usual.end_deg));
    }
}

/// Scales intensities of 0 to 255 to the range 0 to 1.
/// @return a note; empty if nothing was scaled
/// @throws DataError if the intensities are in neither range
std::string scale_intensities(std::vector<RingScan>& raw_scans, const std::string& folder_name) {
    constexpr float kMaxByte = 255.0f;
    // Fractions up to this maximum could be percentages, and are rejected.
    constexpr float kMaxPercent = 100.0f;
    float lowest = 0.0f, highest = 0.0f;
    bool are_integers = true;
    for (const RingScan& scan : raw_scans)
        for (const float intensity : scan.points.intensity) {
            lowest = std::min(lowest, intensity);
            highest = std::max(highest, intensity);
            are_integers = are_integers && intensity == std::floor(intensity);
        }
    if (lowest >= 0.0f && highest <= 1.0f) return "";
    if (lowest < 0.0f || highest > kMaxByte || (!are_integers && highest <= kMaxPercent))
        fail("{}: found intensities from {} to {}, expected 0 to 1, or whole numbers up to 255", folder_name,
             lowest, highest);
    for (RingScan& scan : raw_scans)
        for (float& intensity : scan.points.intensity) intensity /= kMaxByte;
    return fmt::format("intensities are {} up to {}, so they are divided by 255",
                       are_integers ? "whole numbers" : "numbers", highest);
}

/// Checks the number of rays before memory is allocated for them. If a sweep has only few
/// points, the estimated azimuth step of the head can be far too small.
/// @throws DataError if there are too many rays per point
void check_ray_counts(const std::vector<RingScan>& scans, const FiringGrid& grid, const std::string& where) {
    constexpr std::size_t kMostRaysAPoint = 200;  // a complete sweep has about 1.1 rays per point
    // If the head does not fire at every tick, only ticks with points have rays.
    if (!grid.every_tick) return;
    std::size_t n_points = 0;
    for (const RingScan& scan : scans) n_points += scan.points.size();
    const std::size_t n_rays = scans.size() * kRings * std::size_t(grid.head.n_ticks);
    if (n_rays > kMostRaysAPoint * n_points)
        fail(
            "{}: found only {} points in {} sweeps with {} rays each, which follow from the steps between "
            "azimuths; expected complete sweeps of an HDL-64E",
            where, n_points, scans.size(), n_rays / scans.size());
}

/// Returns the number of digits in the name of the first scan.
int count_name_digits(const std::filesystem::path& scan_folder) {
    for (const std::filesystem::path& file : list_folder(scan_folder))
        if (file.extension() == ".bin" && parse_stem(file.stem().string()))
            return int(file.stem().string().size());
    return 0;
}

/// Returns true if a file has about as many rings as an HDL-64E. Some beams may have no
/// returns.
bool has_hdl64_order(const LidarPoints& points) {
    const int n_rings = split_rings(points).n_rings;
    return n_rings > kRings - 5 && n_rings < kRings + 5;
}

/// The scans of a LiDAR that is no HDL-64E.
class KittiScans : public read::ScanProvider {
public:
    KittiScans(const Log& log, std::filesystem::path scan_folder, std::filesystem::path label_folder)
        : log_(log),
          scan_folder_(std::move(scan_folder)),
          label_folder_(std::move(label_folder)),
          digits_(count_name_digits(scan_folder_)) {}
    std::string frame_name(std::size_t frame) const override { return file_of(frame).string(); }
    LidarPoints read_points(std::size_t frame) const override {
        const std::filesystem::path file = file_of(frame);
        const std::string label_name = file.stem().string() + ".label";
        LidarPoints points =
            read_kitti_scan(file, label_folder_.empty() ? label_folder_ : label_folder_ / label_name);
        if (units_.intensity_max)
            for (float& value : points.intensity)
                value = read::scale_intensity(double(value), units_, file.string());
        return points;
    }
    /// Reads some scans that can be read.
    std::vector<LidarPoints> read_samples() const {
        std::vector<LidarPoints> samples;
        for (const std::size_t i : read::spread_indices(log_.frames.size(), kFitScans)) try {
                samples.push_back(read_points(i));
            } catch (const DataError&) {  // reported when all scans are read
            }
        return samples;
    }
    /// Sets the scale of the intensities: that of the user, or an estimate.
    read::IntensityScale set_scale(const std::vector<LidarPoints>& samples, const Conventions& set) {
        std::vector<double> intensities;
        for (const LidarPoints& points : samples)
            intensities.insert(intensities.end(), points.intensity.begin(), points.intensity.end());
        const read::IntensityScale scale =
            read::choose_scale(read::estimate_scale(std::move(intensities)), set);
        units_.intensity_max = scale.max;
        return scale;
    }
    int digits() const { return digits_; }

private:
    const Log& log_;
    const std::filesystem::path scan_folder_, label_folder_;
    const int digits_;
    read::PointFileUnits units_;

    std::filesystem::path file_of(std::size_t frame) const {
        return scan_folder_ / fmt::format("{:0{}d}.bin", log_.frames[frame].index, digits_);
    }
};

}  // namespace

void read_kitti_sweeps(Log& log, const std::filesystem::path& scan_folder, const DatasetOptions& options,
                       bool hdl64_is_moved, const std::filesystem::path& label_folder) {
    KittiScans scans(log, scan_folder, label_folder);
    const std::vector<LidarPoints> samples = scans.read_samples();
    const std::ptrdiff_t n_hdl64 = std::ranges::count_if(samples, has_hdl64_order);
    if (2 * n_hdl64 >= std::ssize(samples)) {
        log.rolling_shutter = !hdl64_is_moved;
        return read_hdl64_sweeps(log, scan_folder, scans.digits(), options, label_folder);
    }
    read::list_scale(log, scans.set_scale(samples, options.conventions), "");
    log.lidars[0].sensor.max_range_m = options.max_range_m;
    DatasetOptions scan_options = options;
    if (!log.has_poses) scan_options.poses_file = kNoPoses;
    read::ScanLayout layout{.lidars = {{}}, .motion_compensated = true};
    read::apply_conventions(log, layout, options.conventions);
    read::read_scans(log, layout, scans, scan_options);
}

void read_hdl64_sweeps(Log& log, const std::filesystem::path& scan_folder, int file_name_digits,
                       const DatasetOptions& options, const std::filesystem::path& label_folder) {
    const Progress& progress = options.progress;
    ScanErrorCollector broken(options.skip_broken);
    const auto file_of = [&](std::size_t frame) {
        return scan_folder / fmt::format("{:0{}d}.bin", log.frames[frame].index, file_name_digits);
    };
    std::vector<RingScan> raw(log.frames.size());
    progress_for(raw.size(), progress, "reading scans", [&](std::size_t frame) {
        broken.guard(frame, [&] {
            const std::filesystem::path file = file_of(frame);
            const std::string label_name = file.stem().string() + ".label";
            raw[frame] = split_rings(
                read_kitti_scan(file, label_folder.empty() ? label_folder : label_folder / label_name));
        });
    });
    record_truncated(
        raw, [&](std::size_t frame) { return file_of(frame).string(); }, broken);
    if (broken.size() == raw.size()) broken.report_broken(log, raw.size());
    for (std::size_t frame = 0; frame < raw.size(); ++frame)
        // Empties broken scans, so that the fits below ignore them.
        if (broken.is_scan_broken(frame)) raw[frame] = {};
    if (std::string note = scale_intensities(raw, scan_folder.string()); !note.empty())
        log.notes.push_back(std::move(note));

    std::optional<read::FiringRecovery> recovery;
    if (!log.rolling_shutter) {
        if (options.rolling_shutter)
            recovery = recover_sweeps(log, raw, scan_folder.string(),
                                      log.has_poses && options.poses_file != kNoPoses);
        if (!log.rolling_shutter)
            log.notes.push_back(
                "the scans are motion-compensated, so all rays start at the position of the sensor at the "
                "time of the frame");
    }
    const BeamCones cones = correct_all_rings(raw, scan_folder.string());
    const FiringGrid lattice = fit_firing_grid(pick_scans(raw, kLatticeScans));
    check_ray_counts(raw, lattice, scan_folder.string());

    const std::vector<Beam> beams = lattice.make_beams(cones);
    std::vector<read::FiredSweep> sweeps(raw.size());
    progress_for(raw.size(), progress, "computing the firings of each sweep", [&](std::size_t frame) {
        broken.guard(frame, [&] {
            std::vector<int> firings = find_fired_ticks(raw[frame], lattice);
            if (firings.empty())
                fail(
                    "{}: found {} points that cannot be assigned to firings of the sensor, expected a sweep "
                    "of an HDL-64E",
                    file_of(frame).string(), raw[frame].points.size());
            sweeps[frame] = {std::move(raw[frame].points), {lattice.head, std::move(firings)}};
            if (recovery) read::set_head_times(sweeps[frame].points, beams, lattice.head, *recovery);
        });
        raw[frame] = {};
    });
    SpinningSensor& sensor = log.lidars[0].sensor;
    sensor.name = "HDL-64E fitted to " + log.name;
    sensor.max_range_m = options.max_range_m;
    sensor.beams = beams;
    read::set_fired_scans(log, sweeps, progress);
    broken.remove_broken(log);
}

}  // namespace relidar::kitti
