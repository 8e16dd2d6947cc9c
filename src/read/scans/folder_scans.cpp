// SPDX-License-Identifier: Apache-2.0
// Reads the scans of a log, from files of a folder or from another provider. A scan is
// stored as rays (npz, EXR) or as points, which become rays by the plan of scan_plan.cpp.
#include <algorithm>
#include <cmath>
#include <map>

#include "base/fail.hpp"
#include "base/progress_blocks.hpp"
#include "read/files/dropped_ray.hpp"
#include "read/files/scan_npz.hpp"
#include "read/scans/broken_scans.hpp"
#include "read/scans/folder_points.hpp"
#include "read/scans/point_times.hpp"
#include "read/scans/pose_conventions.hpp"

namespace relidar::read {
namespace {

namespace fs = std::filesystem;

/// Counts the first returns of rays. Ignores points at the sensor.
std::size_t count_firsts(const LidarPoints& points) {
    std::size_t n = 0;
    for (std::size_t i = 0; i < points.size(); ++i) {
        const float range_m = glm::length(points.position_m[i]);
        const bool is_first = points.return_number.empty() || points.return_number[i] == 1;
        if (is_first && range_m >= kNearestReturn_m) ++n;
    }
    return n;
}

/// Returns true if points have times. If all are 0, they do not show when the points were
/// fired.
bool has_firing_times(const LidarPoints& points) {
    return std::ranges::any_of(points.time_offset_s, [](float time_s) { return time_s != 0.0f; });
}

/// Reads the scans of a folder from their files.
class FolderScans : public ScanProvider {
public:
    FolderScans(const Log& log, const ScanLayout& layout, const PointFileUnits& units,
                const std::vector<fs::path>& files)
        : log_(log), layout_(layout), units_(units), files_(files), has_npz_points_(has_npz_points(files)) {}

    std::string frame_name(std::size_t frame_index) const override { return files_[frame_index].string(); }
    bool stores_points(std::size_t frame_index) const override {
        return !is_image_file(files_[frame_index]) ||
               (has_npz_points_ && files_[frame_index].extension() == ".npz");
    }
    LidarPoints read_points(std::size_t frame_index) const override {
        const PointTable table = read_point_file(files_[frame_index], units_.columns);
        check_deskewing(table.is_deskewed, layout_.motion_compensated, frame_name(frame_index));
        double frame_time_s = log_.frames[frame_index].time_s;
        if (const auto times = find_time_range(table); times && units_.starts_at_frame)
            frame_time_s = units_.time_unit_s * (*times)[0];
        return convert_table(table, units_, frame_time_s, frame_name(frame_index));
    }
    Scan read_rays(std::size_t frame_index) const override {
        const Frame& frame = log_.frames[frame_index];
        return read_scan_image(files_[frame_index], {units_, layout_.motion_compensated,
                                                     layout_.lidars[std::size_t(frame.lidar)].lowest_first,
                                                     log_.lidar_of(frame), frame.time_s});
    }

private:
    const Log& log_;
    const ScanLayout& layout_;
    const PointFileUnits& units_;
    const std::vector<fs::path>& files_;
    const bool has_npz_points_;
};

/// Reads the scans of all frames of a log. First decides for each LiDAR, from a few
/// sample scans, how its points become rays. Several threads then read the frames.
class ScanReader {
public:
    ScanReader(Log& log, const ScanLayout& layout, const ScanProvider& source, const DatasetOptions& options,
               ScanErrorCollector& broken)
        : log_(log),
          layout_(layout),
          source_(source),
          has_poses_(options.poses_file != kNoPoses),
          recovers_firings_(options.rolling_shutter),
          broken_(broken),
          plans_(log.lidars.size()),
          counts_(log.frames.size()) {}

    /// Plans the scans of all LiDARs. Sets their sensors. A log has either a rolling
    /// shutter or not, so if one LiDAR stays motion-compensated, all LiDARs do.
    void plan_lidars() {
        const Notes notes = log_.notes;
        const std::vector<Lidar> lidars = log_.lidars;
        plan_each_lidar();
        if (log_.rolling_shutter || std::ranges::none_of(plans_, &ScanPlan::undoes_motion)) return;
        // Only some LiDARs could undo the compensation, so all are planned to keep it.
        may_undo_motion_ = false;
        log_.notes = notes;
        log_.lidars = lidars;
        samples_.clear();
        std::ranges::fill(counts_, PointCounts{});
        plan_each_lidar();
    }

    /// Reads the scan of a frame by the plan of its LiDAR. Several threads call it.
    void read_frame_scan(std::size_t frame_index) {
        if (!source_.stores_points(frame_index)) {
            log_.frames[frame_index].scan = source_.read_rays(frame_index);
            return;
        }
        LidarPoints points = load_points(frame_index);
        const bool is_usable = remove_late(frame_index, points);
        if (is_usable) make_scan(frame_index, points);
    }

    /// Returns how many points of each frame are skipped.
    const std::vector<PointCounts>& counts() const { return counts_; }

private:
    Log& log_;
    const ScanLayout& layout_;
    const ScanProvider& source_;
    const bool has_poses_;         ///< false: the poses will be estimated from the scans
    const bool recovers_firings_;  ///< true: searches firing times that the log does not contain
    bool may_undo_motion_ = true;  ///< false if motion compensation can be undone for some LiDARs only
    ScanErrorCollector& broken_;
    std::vector<ScanPlan> plans_;      ///< [lidars]
    std::vector<PointCounts> counts_;  ///< [frames]
    /// [frames] points that were already read to estimate the beams
    std::map<std::size_t, LidarPoints> samples_;

    /// Returns true if stored motion compensation can be undone for points with times.
    bool can_undo_motion() const { return layout_.motion_compensated && has_poses_ && may_undo_motion_; }
    ScanPlan& plan_of(std::size_t frame_index) { return plans_[std::size_t(log_.frames[frame_index].lidar)]; }

    double sweep_duration_s(int lidar_index) const {
        const double known_s = layout_.lidars[std::size_t(lidar_index)].sweep_duration_s;
        return known_s > 0.0 ? known_s : estimate_sweep_s(log_, lidar_index);
    }

    /// Plans the scans of each LiDAR on its own.
    void plan_each_lidar() {
        for (int l = 0; l < std::ssize(log_.lidars); ++l) {
            std::vector<std::size_t> with_points;  // frames with points
            for (std::size_t i = 0; i < log_.frames.size(); ++i)
                if (log_.frames[i].lidar == l && source_.stores_points(i)) with_points.push_back(i);
            SpinningSensor& sensor = log_.lidars[std::size_t(l)].sensor;
            if (sensor.name.empty()) sensor.name = log_.name;
            // Files store either points or rays. A LiDAR with rays needs only a sweep
            // period. If its beams are unknown, it is treated as not rotating (period 0).
            if (!with_points.empty()) plan_lidar(l, with_points);
            else if (!layout_.lidars[std::size_t(l)].has_beams) sensor.period_s = 0.0;
            else if (sensor.period_s == 0.0) sensor.period_s = sweep_duration_s(l);
        }
        log_.rolling_shutter =
            !layout_.motion_compensated || std::ranges::all_of(plans_, &ScanPlan::undoes_motion);
    }

    /// Reads the points of a frame. Moves points back to their firing times if the log
    /// says that they were motion-compensated, and if their times are known.
    LidarPoints read_points(std::size_t frame_index, bool undo_motion) const {
        const Frame& frame = log_.frames[frame_index];
        LidarPoints points = source_.read_points(frame_index);
        if (undo_motion && !points.time_offset_s.empty())
            undo_deskew(points, log_.lidar_track(frame.lidar), frame.time_s);
        return points;
    }

    /// Returns the points of a frame, each at its firing time if this is possible. Reuses
    /// samples that were read for the plan. Records a scan with wrong times as broken.
    LidarPoints load_points(std::size_t frame_index) {
        const auto sample = samples_.find(frame_index);
        if (sample != samples_.end()) return std::move(sample->second);
        LidarPoints points;
        try {
            points = read_points(frame_index, plan_of(frame_index).undoes_motion);
            restore(frame_index, points);
        } catch (const MostTimesWrong& error) {
            broken_.record_broken(frame_index, error.what());
        }
        return points;
    }

    /// Removes points whose times are outside the sweep. Returns false if the scan is
    /// skipped, because most of its points have such times.
    bool remove_late(std::size_t frame_index, LidarPoints& points) {
        const TimeLimits& limits = plan_of(frame_index).time_limits;
        const std::size_t n_points = points.size();
        const double middle_s = limits.middle_s.value_or(0.0);
        double worst_s = middle_s;
        for (const float t_s : points.time_offset_s)
            if (std::abs(double(t_s) - middle_s) > std::abs(worst_s - middle_s)) worst_s = double(t_s);
        const std::size_t n_late = remove_mistimed(points, limits.longest_offset_s, limits.middle_s);
        if (2 * n_late > n_points)
            broken_.record_broken(
                frame_index,
                fmt::format("{}: {} of {} points have times outside the sweep, such as {:.6g} s after the "
                            "time of the frame; expected at most {:.3g} s from {:.3g} s, as in other scans",
                            source_.frame_name(frame_index), n_late, n_points, worst_s,
                            limits.longest_offset_s, middle_s));
        else counts_[frame_index].late += n_late;
        return !broken_.is_scan_broken(frame_index);
    }

    /// Assigns the points of a frame to the rays of its LiDAR.
    void make_scan(std::size_t frame_index, LidarPoints& points) {
        Frame& frame = log_.frames[frame_index];
        const ScanPlan& plan = plan_of(frame_index);
        const bool has_rings = !points.ring.empty(), has_times = !points.time_offset_s.empty();
        if (points.size() > 0 && (plan.has_rings != has_rings || plan.has_times != has_times))
            fail(
                "{}: its points have {} and {}, unlike the points of other scans of this LiDAR; expected the "
                "same fields in all scans",
                source_.frame_name(frame_index), has_rings ? "rings" : "no rings",
                has_times ? "times" : "no times");
        // Without a sensor model, dropped rays are unknown, so each point becomes a ray.
        if (!plan.has_beams) {
            frame.scan = scan_of_points(points);
            return;
        }
        if (plan.ring_order) plan.ring_order->number_rings(points);
        if (plan.has_rings || plan.ring_order) map_rings(points, plan, frame_index);
        else assign_rings(points, plan.sensor.beams);
        const SweepFirings sweep = fit_even_sweep(points, plan.sensor);
        if (plan.firings) set_head_times(points, plan.sensor.beams, sweep.lattice, plan.firings->recovery);
        frame.scan = spinning_scan(points, plan.sensor, sweep);
        PointCounts& counts = counts_[frame_index];
        counts.first = count_firsts(points);
        counts.behind = counts.first - std::min(counts.first, frame.scan.count_returns());
    }

    /// Adds the points of a frame to `samples`, unless it has none. If its times are
    /// wrong, adds the error to `wrong` instead.
    void load_sample(std::size_t frame_index, std::map<std::size_t, LidarPoints>& samples,
                     std::map<std::size_t, std::string>& wrong) {
        broken_.guard(frame_index, [&] {
            try {
                LidarPoints points = read_points(frame_index, can_undo_motion());
                if (points.size() > 0) samples.emplace(frame_index, std::move(points));
            } catch (const MostTimesWrong& error) {
                wrong.emplace(frame_index, error.what());
            }
        });
    }

    /// Reads the points of a few frames, or of all frames until one has points. A scan
    /// whose times are wrong is broken if the times of other scans are right. Otherwise
    /// it is an error, because the unit of the times is probably wrong.
    std::map<std::size_t, LidarPoints> load_samples(const std::vector<std::size_t>& frame_indices) {
        std::map<std::size_t, LidarPoints> samples;
        std::map<std::size_t, std::string> wrong;
        const std::size_t n = std::min(kSampleScans, frame_indices.size());
        for (std::size_t k = 0; k < n; ++k)
            load_sample(frame_indices[k * frame_indices.size() / n], samples, wrong);
        for (std::size_t k = 0; samples.empty() && k < frame_indices.size(); ++k)
            load_sample(frame_indices[k], samples, wrong);
        for (const auto& [frame_index, text] : wrong) {
            if (double(samples.size()) >= kMinScanShare * double(n)) broken_.record_broken(frame_index, text);
            else broken_.guard(frame_index, [&] { throw DataError(text); });
        }
        if (samples.empty()) broken_.report_broken(log_, broken_.size());
        return samples;
    }

    /// Searches how points were moved if the log does not say it. Restores the samples.
    void recover_firings(int lidar_index, std::map<std::size_t, LidarPoints>& samples, double sweep_s) {
        const auto l = std::size_t(lidar_index);
        if (!recovers_firings_ || !layout_.lidars[l].spins) return;
        std::vector<CompensatedSweep> sweeps;
        for (const auto& [frame_index, points] : samples)
            sweeps.push_back({points, log_.frames[frame_index].time_s});
        const bool has_times = std::ranges::any_of(
            sweeps, [](const CompensatedSweep& sweep) { return has_firing_times(sweep.points); });
        const Lidar& lidar = log_.lidars[l];
        CompensatedSensor sensor{
            .period_s = sweep_s,
            .forward = inverse(lidar.vehicle_from_sensor).rotation * glm::dvec3(1, 0, 0)};
        if (has_poses_) sensor.world_from_sensor = log_.lidar_track(lidar_index);
        // The points were moved, but their times are not stored.
        if (layout_.motion_compensated && may_undo_motion_ && !has_times)
            plans_[l].firings = plan_firings(std::move(sweeps), sensor);
        // sequence.json may lack the flag.
        else if (layout_.is_described && !layout_.motion_compensated && !layout_.is_deskew_set && !has_times)
            plans_[l].unmarked_firings = plan_firings(std::move(sweeps), sensor);
        // The times are stored, but the points may have been moved without notice.
        if (!layout_.motion_compensated && !layout_.is_deskew_set && has_times && has_poses_)
            plans_[l].moved_to_s = find_moved_time(sweeps, *sensor.world_from_sensor);
        for (auto& [frame_index, points] : samples) restore(frame_index, points);
    }

    /// Moves points back to their firing times, as far as recover_firings() found them.
    void restore(std::size_t frame_index, LidarPoints& points) {
        const Frame& frame = log_.frames[frame_index];
        const ScanPlan& plan = plan_of(frame_index);
        if (plan.firings) plan.firings->restore(points, frame.time_s);
        if (plan.moved_to_s)
            undo_deskew_to(points, log_.lidar_track(frame.lidar), frame.time_s, *plan.moved_to_s);
    }

    /// Decides from a few sample scans how the scans of a LiDAR are read. Points with
    /// wrong times are removed first, because they would disturb the fit of the sensor.
    void plan_lidar(int lidar_index, const std::vector<std::size_t>& frame_indices) {
        const auto l = std::size_t(lidar_index);
        ScanPlan& plan = plans_[l];
        plan = {};
        std::map<std::size_t, LidarPoints> sample_of_frame = load_samples(frame_indices);
        const auto list_samples = [&] {
            std::vector<LidarPoints> samples;
            for (const auto& [frame_index, points] : sample_of_frame) samples.push_back(points);
            return samples;
        };
        const double sweep_s = sweep_duration_s(lidar_index);
        recover_firings(lidar_index, sample_of_frame, sweep_s);
        plan.time_limits = find_time_limits(list_samples(), sweep_s);
        for (auto sample = sample_of_frame.begin(); sample != sample_of_frame.end();) {
            const bool is_usable = remove_late(sample->first, sample->second);
            sample = is_usable ? std::next(sample) : sample_of_frame.erase(sample);
        }

        const std::vector<LidarPoints> samples = list_samples();
        Lidar& lidar = log_.lidars[l];
        plan.sensor = lidar.sensor;
        plan_rays(plan, layout_.lidars[l], sweep_s, samples);
        plan.undoes_motion =
            plan.firings || (can_undo_motion() && std::ranges::any_of(samples, has_firing_times));
        if (plan.is_contradiction && layout_.is_described)
            fail("{}: LiDAR '{}': {}; use \"spins\": false in sequence.json to read each point as one ray",
                 log_.source, lidar.name, plan.why_no_beams);
        lidar.sensor = plan.sensor;
        note_plan(log_, layout_, lidar_index, plan, samples);
        samples_.merge(sample_of_frame);
    }

    /// Replaces ring numbers by beam numbers. Removes points of rings without a beam.
    void map_rings(LidarPoints& points, const ScanPlan& plan, std::size_t frame_index) {
        std::vector<std::size_t> kept;
        for (std::size_t p = 0; p < points.size(); ++p) {
            const std::uint16_t ring = points.ring[p];
            const std::uint16_t beam = ring < plan.beam_of_ring.size() ? plan.beam_of_ring[ring] : kNoBeam;
            if (beam == kNoBeam && !plan.is_fitted)
                fail("{}: a point has the ring number {}, expected the number of one of {} beams",
                     source_.frame_name(frame_index), ring, plan.beam_of_ring.size());
            points.ring[p] = beam;
            if (beam != kNoBeam) kept.push_back(p);
        }
        counts_[frame_index].without_beam += points.size() - kept.size();
        select_points(points, kept);
    }
};

/// Returns the indices of the frames whose scans will be read, evenly spread over the
/// log.
/// @param max_scans  maximum number of scans per LiDAR; 0: all
std::vector<std::size_t> select_frames(const Log& log, int max_scans) {
    std::vector<std::vector<std::size_t>> frames_by_lidar(log.lidars.size());
    for (std::size_t i = 0; i < log.frames.size(); ++i)
        frames_by_lidar[std::size_t(log.frames[i].lidar)].push_back(i);
    std::vector<std::size_t> all;
    for (const std::vector<std::size_t>& frames : frames_by_lidar) {
        const std::size_t n = max_scans > 0 ? std::min(std::size_t(max_scans), frames.size()) : frames.size();
        for (std::size_t k = 0; k < n; ++k) all.push_back(frames[k * frames.size() / n]);
    }
    std::ranges::sort(all);
    return all;
}

}  // namespace

void apply_conventions(Log& log, ScanLayout& layout, const Conventions& set) {
    const bool sets_deskew = set.deskew != Conventions::Deskew::automatic,
               sets_rings = set.rings != Conventions::Rings::automatic;
    if (sets_deskew) layout.motion_compensated = set.deskew == Conventions::Deskew::deskewed;
    layout.is_deskew_set = sets_deskew;
    list_convention(log, {"points", layout.motion_compensated ? "motion-compensated" : "raw",
                          sets_deskew                 ? kFromSetting
                          : layout.is_deskew_declared ? layout.declared_by
                                                      : "default",
                          "conventions.deskew"});
    for (LidarScanLayout& lidar : layout.lidars)
        if (sets_rings) lidar.lowest_first = set.rings == Conventions::Rings::lowest_first;
    layout.are_rings_set = sets_rings;
}

void read_scans(Log& log, const ScanLayout& layout, const ScanProvider& scan_provider,
                const DatasetOptions& options) {
    ScanErrorCollector broken(options.skip_broken);
    ScanReader reader(log, layout, scan_provider, options, broken);
    reader.plan_lidars();
    const std::vector<std::size_t> frames = select_frames(log, options.max_scans);
    progress_for(frames.size(), options.progress, "reading scans", [&](std::size_t index) {
        // guard() records an error of the frame, or throws it without skip_broken.
        broken.guard(frames[index], [&] { reader.read_frame_scan(frames[index]); });
    });
    note_skipped_points(log, layout, reader.counts());
    broken.remove_broken(log);
}

void read_scan_files(Log& log, ScanLayout layout, PointFileUnits units,
                     const std::vector<fs::path>& scan_files, const DatasetOptions& options) {
    apply_conventions(log, layout, options.conventions);
    fill_units(units, scan_files, layout.declared_by, options.conventions, log);
    read_scans(log, layout, FolderScans(log, layout, units, scan_files), options);
}

}  // namespace relidar::read
