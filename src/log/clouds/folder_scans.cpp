// SPDX-License-Identifier: Apache-2.0
// Reads the scans of a plain folder. A scan file contains rays (npz, EXR) or points.
// Points are assigned to rays. Unknown rings or beams are first estimated from a few
// scans of each LiDAR.
#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <optional>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/fail.hpp"
#include "base/median.hpp"
#include "base/progress_blocks.hpp"
#include "log/clouds/broken_scans.hpp"
#include "log/clouds/dropped_ray.hpp"
#include "log/clouds/file_order.hpp"
#include "log/clouds/folder_head.hpp"
#include "log/clouds/folder_points.hpp"
#include "log/clouds/head_spins.hpp"
#include "log/clouds/missing_units.hpp"
#include "log/clouds/point_times.hpp"
#include "log/clouds/scan_npz.hpp"
#include "log/clouds/thinned_cloud.hpp"

namespace relidar::folder {
namespace {

namespace fs = std::filesystem;

// sweep period in seconds that is assumed if the log has only one frame
constexpr double kUsualPeriod_s = 0.1;
// The slowest spinning LiDARs of vehicles make five revolutions per second. If scans are
// farther apart, the log has only some of the scans.
constexpr double kLongestPeriod_s = 0.25;
// If a larger share of the points fits no ray, the sensor of the log is probably wrong.
constexpr double kMostSkipped = 0.1;
// If scans are farther apart, the unit of their times is probably wrong.
constexpr double kLongestFrameStep_s = 20.0;

/// Counts the points that are the first return of their ray. Ignores points at the
/// sensor.
std::size_t count_first_returns(const LidarPoints& points) {
    std::size_t n = 0;
    for (std::size_t i = 0; i < points.size(); ++i) {
        const float range_m = glm::length(points.position_m[i]);
        const bool is_first = points.return_number.empty() || points.return_number[i] == 1;
        n += is_first && range_m >= kNearestReturn_m;
    }
    return n;
}

/// How the points of one LiDAR are converted to scans.
struct ScanConversionPlan {
    /// true if points are assigned to beams and columns; false if each point becomes a
    /// ray
    bool ordered = false;
    /// true if the points in the files have ring numbers; true if they have times
    bool has_rings = false, has_times = false;
    bool undo = false;                   ///< true: motion compensation is undone
    double longest_offset_s = INFINITY;  ///< largest plausible distance of a time from the median time
    std::optional<double> middle_s;      ///< median time of most scans; not set if they disagree
    /// [rings] beam of each ring number in the files; kNoBeam: points of this ring are
    /// ignored
    std::vector<std::uint16_t> beam_of_ring;
    /// Finds rings from the order of the points in the files. Set if the points have no
    /// ring numbers and are stored ring by ring.
    std::optional<RingOrderDetector> order;
};

/// Reads the scans of a folder from their files.
class FolderScanProvider : public ScanProvider {
public:
    FolderScanProvider(const LidarSequence& sequence, const SequenceHeader& head,
                       const std::vector<fs::path>& files)
        : sequence_(sequence), head_(head), files_(files), has_npz_points_(has_npz_points(files)) {}

    std::string get_frame_name(std::size_t frame_index) const override {
        return files_[frame_index].string();
    }
    bool is_stored_as_points(std::size_t frame_index) const override {
        return !is_image_file(files_[frame_index]) ||
               (has_npz_points_ && files_[frame_index].extension() == ".npz");
    }
    LidarPoints read_points_of_frame(std::size_t frame_index) const override {
        const PointTable table = read_point_file(files_[frame_index], head_.units.columns);
        require_deskewing_declared_in_header(table.is_deskewed, head_, get_frame_name(frame_index));
        return convert_table_to_points(table, head_.units, sequence_.frames[frame_index].time_s,
                                       get_frame_name(frame_index));
    }
    Scan read_rays_of_frame(std::size_t frame_index) const override {
        const LidarFrame& frame = sequence_.frames[frame_index];
        const ScanImageContext source{head_, head_.lidars[std::size_t(frame.lidar)],
                                      sequence_.get_lidar(frame), frame.time_s};
        return files_[frame_index].extension() == ".exr" ? read_scan_exr(files_[frame_index], source)
                                                         : read_scan_npz(files_[frame_index], source);
    }

private:
    const LidarSequence& sequence_;
    const SequenceHeader& head_;
    const std::vector<fs::path>& files_;
    const bool has_npz_points_;
};

class FolderScanReader {
public:
    FolderScanReader(LidarSequence& sequence, const SequenceHeader& head, const ScanProvider& source,
                     bool has_poses, ScanErrorCollector& broken)
        : sequence_(sequence),
          head_(head),
          source_(source),
          has_poses_(has_poses),
          broken_(broken),
          plans_(head.lidars.size()),
          left_out_(sequence.frames.size(), 0),
          n_first_(sequence.frames.size(), 0),
          n_late_(sequence.frames.size(), 0),
          behind_(sequence.frames.size(), 0) {}

    void determine_sensor_of_each_lidar() {
        for (std::size_t l = 0; l < plans_.size(); ++l) {
            std::vector<std::size_t> with_points;  // frames with points
            for (std::size_t i = 0; i < sequence_.frames.size(); ++i)
                if (sequence_.frames[i].lidar == int(l) && source_.is_stored_as_points(i))
                    with_points.push_back(i);
            SpinningSensor& sensor = sequence_.lidars[l].sensor;
            if (sensor.name.empty()) sensor.name = sequence_.name;
            // Files store either points or rays. A LiDAR with rays needs only a sweep
            // period. If its beams are unknown, it is treated as not rotating (period 0).
            if (!with_points.empty()) choose_scan_conversion_plan_of_lidar(l, with_points);
            else if (!head_.lidars[l].has_beams) sensor.period_s = 0.0;
            else if (sensor.period_s == 0.0) sensor.period_s = get_or_estimate_sweep_duration_s(l);
        }
        const auto stands = [&](const ScanConversionPlan& plan) { return !plan.undo; };
        sequence_.rolling_shutter =
            !head_.motion_compensated || std::none_of(plans_.begin(), plans_.end(), stands);
    }

    void read_frame_scan(std::size_t frame_index) {
        LidarFrame& frame = sequence_.frames[frame_index];
        if (!source_.is_stored_as_points(frame_index)) {
            frame.scan = source_.read_rays_of_frame(frame_index);
            return;
        }
        const ScanConversionPlan& plan = plans_[std::size_t(frame.lidar)];
        const SpinningSensor& sensor = sequence_.get_lidar(frame).sensor;
        const auto sample = samples_.find(frame_index);
        LidarPoints points;
        try {
            points =
                sample == samples_.end() ? read_points(frame_index, plan.undo) : std::move(sample->second);
        } catch (const MostTimesWrong& error) {
            broken_.record_broken_scan(frame_index, error.what());
        }
        if (!remove_late_points(frame_index, points)) return;
        const bool has_points = points.size() > 0;
        if (has_points &&
            (plan.has_rings == points.ring.empty() || plan.has_times == points.time_offset_s.empty()))
            fail(
                "{}: its points have {} and {}, unlike the points of other scans of this LiDAR; expected the "
                "same fields in all scans",
                source_.get_frame_name(frame_index), points.ring.empty() ? "no rings" : "rings",
                points.time_offset_s.empty() ? "no times" : "times");
        if (!plan.ordered) {
            frame.scan = make_scan_with_one_ray_per_point(points);
            return;
        }
        if (plan.order) plan.order->assign_ring_numbers(points);
        if (plan.has_rings || plan.order) points = convert_rings_to_beams(points, plan, frame_index);
        else assign_points_to_rings(points, sensor.beams);
        frame.scan = assign_points_to_rays_of_spinning_scan(
            points, sensor, fit_equal_azimuth_steps_to_points(points, sensor));
        n_first_[frame_index] = count_first_returns(points);
        behind_[frame_index] =
            n_first_[frame_index] - std::min(n_first_[frame_index], frame.scan.count_returns());
    }

    void add_notes_on_skipped_points() {
        if (const std::size_t n = std::reduce(left_out_.begin(), left_out_.end()); n > 0)
            add_note_once(fmt::format(
                "{} points are skipped, because the fitted sensor has no beam for their rings", n));
        if (const auto worst = std::ranges::max_element(n_late_); worst != n_late_.end() && *worst > 0)
            add_note_once(
                fmt::format("{} points of {} scans are skipped, because their times are outside the sweep of "
                            "their scan, most of them in frame {}",
                            std::reduce(n_late_.begin(), n_late_.end()),
                            std::ranges::count_if(n_late_, [](std::size_t n) { return n > 0; }),
                            sequence_.frames[std::size_t(worst - n_late_.begin())].index));
        for (std::size_t l = 0; l < plans_.size(); ++l) {
            std::size_t n = 0, all = 0;
            for (std::size_t i = 0; i < behind_.size(); ++i) {
                if (sequence_.frames[i].lidar != int(l)) continue;
                n += behind_[i];
                all += n_first_[i];
            }
            const SequenceHeaderLidar& lidar = head_.lidars[l];
            const char* cause =
                lidar.has_beams && !lidar.is_guessed
                    ? "; the usual cause is a sensor in sequence.json that did not measure these points"
                    : "; the usual cause is several returns of each ray without numbers";
            if (n > 0)
                add_note_once(l, fmt::format("{} of {} points ({:.2g} %) are skipped, because their ray has "
                                             "a nearer point and no neighbouring ray is free{}",
                                             n, all, 100.0 * double(n) / double(all),
                                             double(n) > kMostSkipped * double(all) ? cause : ""));
        }
    }

private:
    LidarSequence& sequence_;
    const SequenceHeader& head_;
    const ScanProvider& source_;
    const bool has_poses_;
    ScanErrorCollector& broken_;
    std::vector<ScanConversionPlan> plans_;  ///< [lidars] settings for converting the points of each LiDAR
    /// [frames] points that were already read to estimate the beams
    std::map<std::size_t, LidarPoints> samples_;
    std::vector<std::size_t> left_out_;  ///< [frames] number of ignored points
    std::vector<std::size_t> n_first_;   ///< [frames] number of first returns
    std::vector<std::size_t> n_late_;    ///< [frames] number of points with a wrong time
    /// [frames] number of points that are skipped, because their ray has a nearer point
    std::vector<std::size_t> behind_;

    void add_note_once(const std::string& text) {
        if (std::find(sequence_.notes.begin(), sequence_.notes.end(), text) == sequence_.notes.end())
            sequence_.notes.push_back(text);
    }
    void add_note_once(std::size_t lidar_index, const std::string& text) {
        const std::string& name = sequence_.lidars[lidar_index].name;
        add_note_once(name.empty() ? text : fmt::format("LiDAR '{}': {}", name, text));
    }

    LidarPoints read_points(std::size_t frame_index, bool undo_motion) const {
        const LidarFrame& frame = sequence_.frames[frame_index];
        LidarPoints points = source_.read_points_of_frame(frame_index);
        if (undo_motion && !points.time_offset_s.empty())
            undo_motion_compensation(points, sequence_.get_world_from_sensor(frame.lidar), frame.time_s);
        return points;
    }

    /// Returns the median time between consecutive frames of a LiDAR.
    /// @return no value if the LiDAR has only one frame
    std::optional<double> find_median_frame_step_s(std::size_t lidar_index) const {
        std::vector<double> steps;
        double before_s = NAN;
        for (const LidarFrame& frame : sequence_.frames) {
            if (frame.lidar != int(lidar_index)) continue;
            if (frame.time_s > before_s) steps.push_back(frame.time_s - before_s);
            before_s = frame.time_s;
        }
        return steps.empty() ? std::nullopt : std::optional(compute_median(std::move(steps)));
    }

    /// Returns the duration of a revolution that the user gave. Otherwise returns the
    /// median time between frames of the LiDAR, divided by the number of revolutions if
    /// the log has only every n-th scan.
    double get_or_estimate_sweep_duration_s(std::size_t lidar_index) const {
        if (head_.lidars[lidar_index].sweep_duration_s > 0.0)
            return head_.lidars[lidar_index].sweep_duration_s;
        const double step_s = find_median_frame_step_s(lidar_index).value_or(kUsualPeriod_s);
        return step_s > kLongestPeriod_s ? step_s / std::round(step_s / kUsualPeriod_s) : step_s;
    }

    /// Removes points whose times are outside the sweep. Returns false if the scan is
    /// skipped, because most of its points have such times.
    bool remove_late_points(std::size_t frame_index, LidarPoints& points) {
        const ScanConversionPlan& plan = plans_[std::size_t(sequence_.frames[frame_index].lidar)];
        const std::size_t n = points.size();
        const double middle_s = plan.middle_s.value_or(0.0);
        double worst_s = middle_s;
        for (const float t_s : points.time_offset_s)
            if (std::abs(double(t_s) - middle_s) > std::abs(worst_s - middle_s)) worst_s = double(t_s);
        const std::size_t n_late = remove_points_of_wrong_time(points, plan.longest_offset_s, plan.middle_s);
        if (2 * n_late > n)
            broken_.record_broken_scan(
                frame_index,
                fmt::format("{}: {} of {} points have times outside the sweep, such as {:.6g} s after the "
                            "time of the frame; expected at most {:.3g} s from {:.3g} s, as in other scans",
                            source_.get_frame_name(frame_index), n_late, n, worst_s, plan.longest_offset_s,
                            middle_s));
        else n_late_[frame_index] += n_late;
        return !broken_.is_scan_broken(frame_index);
    }

    /// Returns how far the time of a point can be from the median time of its scan.
    double estimate_longest_offset_s(std::size_t lidar_index, const std::vector<LidarPoints>& samples) const {
        constexpr double kMargin = 1.5;
        std::vector<double> spans_s;
        for (const LidarPoints& points : samples) spans_s.push_back(estimate_sweep_span_s(points));
        const double span_s = spans_s.empty() ? 0.0 : compute_median(std::move(spans_s));
        return kMargin * std::max(span_s, get_or_estimate_sweep_duration_s(lidar_index));
    }

    void choose_scan_conversion_plan_of_lidar(std::size_t lidar_index,
                                              const std::vector<std::size_t>& frame_indices) {
        ScanConversionPlan& plan = plans_[lidar_index];
        std::vector<LidarPoints> samples;
        std::vector<std::size_t> of_sample;  // frame of each sample
        std::map<std::size_t, std::string> wrong;
        const auto add_sample = [&](std::size_t index) {
            broken_.call_and_record_scan_errors(index, [&] {
                try {
                    LidarPoints points = read_points(index, head_.motion_compensated && has_poses_);
                    if (points.size() == 0) return;
                    samples.push_back(std::move(points));
                    of_sample.push_back(index);
                } catch (const MostTimesWrong& error) {
                    wrong.emplace(index, error.what());
                }
            });
        };
        const std::size_t n = std::min(kSampleScans, frame_indices.size());
        for (std::size_t k = 0; k < n; ++k) add_sample(frame_indices[k * frame_indices.size() / n]);
        for (std::size_t k = 0; samples.empty() && k < frame_indices.size(); ++k)
            add_sample(frame_indices[k]);
        for (const auto& [index, text] : wrong) {
            if (double(samples.size()) >= kMostScans * double(n)) broken_.record_broken_scan(index, text);
            else broken_.call_and_record_scan_errors(index, [&] { throw DataError(text); });
        }
        if (samples.empty()) {
            broken_.note_broken_scans_or_throw_if_all_broken(sequence_, broken_.size());
            add_note_once(lidar_index, "no scan has a point with finite coordinates");
        }
        plan.longest_offset_s = estimate_longest_offset_s(lidar_index, samples);
        plan.middle_s = find_middle_time_s(samples, plan.longest_offset_s);
        for (std::size_t k = samples.size(); k-- > 0;) {
            if (remove_late_points(of_sample[k], samples[k])) continue;
            samples.erase(samples.begin() + std::ptrdiff_t(k));
            of_sample.erase(of_sample.begin() + std::ptrdiff_t(k));
        }
        plan.has_rings = samples.empty() || !samples[0].ring.empty();
        plan.has_times = samples.empty() || !samples[0].time_offset_s.empty();
        plan.undo = head_.motion_compensated && has_poses_ && plan.has_times;
        SpinningSensor& sensor = sequence_.lidars[lidar_index].sensor;
        if (sensor.period_s == 0.0 || !head_.lidars[lidar_index].has_beams)
            sensor.period_s = get_or_estimate_sweep_duration_s(lidar_index);
        if (head_.lidars[lidar_index].has_beams) use_known_beams_of_lidar(lidar_index);
        else if (head_.lidars[lidar_index].spins && !samples.empty())
            fit_spinning_sensor_or_note_why_not(lidar_index, samples);
        if (!plan.ordered) sensor.period_s = 0.0;
        if (plan.ordered && !plan.has_times && !head_.motion_compensated)
            add_note_once(
                lidar_index,
                fmt::format(
                    "the points have no times; relidar computes them from the azimuths and assumes that a "
                    "sweep takes {:.3g} s and that the LiDAR's head faces forward at the time of the frame",
                    sensor.period_s));
        // The check "time_unit" reports scans that are much farther apart.
        const double step_s = find_median_frame_step_s(lidar_index).value_or(INFINITY);
        if (!head_.motion_compensated && step_s <= kLongestFrameStep_s)
            if (const std::string text = describe_implausible_times(samples, step_s); !text.empty())
                add_note_once(lidar_index, text);
        if (head_.motion_compensated && !plan.undo)
            add_note_once(lidar_index,
                          "the scans are motion-compensated. This cannot be undone without times of points "
                          "and poses, so all rays start at the sensor's position at the time of the frame");
        for (std::size_t k = 0; k < samples.size(); ++k) {
            // Removes ring numbers that are not in the files. They were estimated to fit
            // the sensor.
            if (!plan.has_rings) samples[k].ring.clear();
            samples_.emplace(of_sample[k], std::move(samples[k]));
        }
    }

    void use_known_beams_of_lidar(std::size_t lidar_index) {
        ScanConversionPlan& plan = plans_[lidar_index];
        const std::size_t n = sequence_.lidars[lidar_index].sensor.beams.size();
        plan.ordered = true;
        for (std::size_t k = 0; k < n; ++k)
            plan.beam_of_ring.push_back(
                std::uint16_t(head_.lidars[lidar_index].lowest_first ? n - 1 - k : k));
        if (!plan.has_rings)
            add_note_once(
                lidar_index,
                "the points have no rings; each point is assigned to the beam with the nearest elevation");
    }

    void fit_spinning_sensor_or_note_why_not(std::size_t lidar_index,
                                             std::vector<LidarPoints>& sample_scans) {
        ScanConversionPlan& plan = plans_[lidar_index];
        SpinningSensor& sensor = sequence_.lidars[lidar_index].sensor;
        if (!plan.has_rings && !try_to_assign_ring_numbers(lidar_index, sample_scans)) {
            add_note_once(lidar_index,
                          "the points have no rings, and neither their order nor their elevations show the "
                          "rings; therefore dropped rays and the order of the rays in an image are unknown" +
                              format_hint_to_set_sensor(lidar_index));
            return;
        }
        const double step_s = sensor.period_s;
        std::optional<SpinningSensor> fitted_sensor =
            fit_sensor_to_samples(lidar_index, sample_scans, step_s);
        std::string why = fitted_sensor ? explain_why_not_spinning(sample_scans, *fitted_sensor, step_s) : "";
        if (fitted_sensor && why.empty() && !plan.has_rings)
            why = explain_removed_points(sample_scans, *fitted_sensor);
        if (!why.empty()) {
            add_note_once(
                lidar_index,
                fmt::format("{}; therefore the LiDAR is not modelled as a spinning sensor: each point "
                            "becomes one ray, and dropped rays (rays without return) are unknown{}",
                            why, plan.has_rings ? "" : format_hint_to_set_sensor(lidar_index)));
            fitted_sensor = std::nullopt;
        }
        if (!fitted_sensor) plan.order.reset();
        if (!fitted_sensor) return;
        fitted_sensor->name = sensor.name;
        fitted_sensor->min_range_m = sensor.min_range_m;
        fitted_sensor->max_range_m = sensor.max_range_m;
        fitted_sensor->divergence_rad = sensor.divergence_rad;
        sensor = *fitted_sensor;
        plan.ordered = true;
        const char* ring_note = "";
        if (plan.order) ring_note = ", which have no rings; their order in the file shows the rings";
        else if (!plan.has_rings) ring_note = ", which have no rings";
        add_note_once(lidar_index,
                      fmt::format("a sensor with {} beams and {} columns was fitted to the points{}",
                                  fitted_sensor->beams.size(), fitted_sensor->columns, ring_note));
    }

    /// Sets ring numbers of points that have none, from their elevations or from their
    /// order. Returns false if both methods fail.
    bool try_to_assign_ring_numbers(std::size_t lidar_index, std::vector<LidarPoints>& sample_scans) {
        // Assigns rings by elevation if it can. The fallback, the order of the points,
        // fails for Ouster LiDARs, because their rings begin at different azimuths.
        if (const std::vector<Beam> beams = estimate_beams(sample_scans); !beams.empty()) {
            for (LidarPoints& sample : sample_scans) assign_points_to_rings(sample, beams);
            return true;
        }
        const RingOrderDetector order(sample_scans);
        if (!order.is_stored_ring_by_ring()) return false;
        for (LidarPoints& sample : sample_scans) order.assign_ring_numbers(sample);
        plans_[lidar_index].order = order;
        return true;
    }

    /// Returns a hint that the user can set the sensor in sequence.json. Returns an empty
    /// string for logs that do not have this file.
    std::string format_hint_to_set_sensor(std::size_t lidar_index) const {
        return head_.lidars[lidar_index].is_guessed
                   ? ""
                   : "; set the key \"sensor\" of the LiDAR in sequence.json to define its beams";
    }

    std::optional<SpinningSensor> fit_sensor_to_samples(std::size_t lidar_index,
                                                        const std::vector<LidarPoints>& sample_scans,
                                                        double period_s) {
        try {
            const FittedSensor fit = estimate_spinning_sensor(sample_scans, period_s);
            if (fit.sensor.beams.size() * std::size_t(fit.sensor.columns) > kMaxRays)
                fail("the fitted sensor has {} beams and {} columns, expected at most {} rays",
                     fit.sensor.beams.size(), fit.sensor.columns, kMaxRays);
            plans_[lidar_index].beam_of_ring = fit.beam_of_ring;
            return fit.sensor;
        } catch (const DataError& error) {
            if (head_.lidars[lidar_index].is_guessed) {
                add_note_once(lidar_index, fmt::format("{}; therefore each point becomes one ray, and "
                                                       "dropped rays (rays without return) are unknown",
                                                       error.what()));
                return std::nullopt;
            }
            fail("{}: LiDAR '{}': {}; use \"spins\": false in sequence.json to read each point as one ray",
                 sequence_.source, sequence_.lidars[lidar_index].name, error.what());
        }
    }

    /// Replaces ring numbers of the file by beam numbers. Removes points of rings without
    /// a beam.
    LidarPoints convert_rings_to_beams(const LidarPoints& points, const ScanConversionPlan& plan,
                                       std::size_t frame_index) {
        LidarPoints renumbered_points;
        for (std::size_t p = 0; p < points.size(); ++p) {
            const std::uint16_t ring = points.ring[p],
                                beam = ring < plan.beam_of_ring.size() ? plan.beam_of_ring[ring] : kNoBeam;
            if (beam == kNoBeam && head_.lidars[std::size_t(sequence_.frames[frame_index].lidar)].has_beams)
                fail(
                    "{}: a point has the ring number {}, expected a ring number below {}, because the sensor "
                    "of the LiDAR has {} beams",
                    source_.get_frame_name(frame_index), ring, plan.beam_of_ring.size(),
                    plan.beam_of_ring.size());
            if (beam == kNoBeam) {
                ++left_out_[frame_index];
                continue;
            }
            renumbered_points.position_m.push_back(points.position_m[p]);
            renumbered_points.intensity.push_back(points.intensity[p]);
            renumbered_points.ring.push_back(beam);
            if (!points.time_offset_s.empty())
                renumbered_points.time_offset_s.push_back(points.time_offset_s[p]);
            if (!points.return_number.empty())
                renumbered_points.return_number.push_back(points.return_number[p]);
        }
        return renumbered_points;
    }
};

/// Returns the indices of the frames whose scans will be read.
/// @param max_scans  maximum number of scans per LiDAR
std::vector<std::size_t> select_frames_to_read(const LidarSequence& sequence, int max_scans) {
    std::vector<std::vector<std::size_t>> frames_by_lidar(sequence.lidars.size());
    for (std::size_t i = 0; i < sequence.frames.size(); ++i)
        frames_by_lidar[std::size_t(sequence.frames[i].lidar)].push_back(i);
    std::vector<std::size_t> all;
    for (const std::vector<std::size_t>& frames : frames_by_lidar) {
        const std::size_t n = max_scans > 0 ? std::min(std::size_t(max_scans), frames.size()) : frames.size();
        for (std::size_t k = 0; k < n; ++k) all.push_back(frames[k * frames.size() / n]);
    }
    std::ranges::sort(all);
    return all;
}

}  // namespace

void read_scans(LidarSequence& sequence, const SequenceHeader& sequence_header,
                const ScanProvider& scan_provider, const DatasetOptions& options) {
    ScanErrorCollector broken(options.skip_broken);
    FolderScanReader reader(sequence, sequence_header, scan_provider, options.poses_file != kNoPoses, broken);
    reader.determine_sensor_of_each_lidar();
    const std::vector<std::size_t> frames = select_frames_to_read(sequence, options.max_scans);
    parallel_for_with_progress(frames.size(), options.progress, "reading scans", [&](std::size_t index) {
        broken.call_and_record_scan_errors(frames[index], [&] { reader.read_frame_scan(frames[index]); });
    });
    reader.add_notes_on_skipped_points();
    broken.remove_broken_frames(sequence);
}

void read_scans(LidarSequence& sequence, const SequenceHeader& sequence_header,
                const std::vector<fs::path>& scan_files, const DatasetOptions& options) {
    SequenceHeader complete = sequence_header;
    estimate_missing_point_units(complete, scan_files, sequence.notes);
    read_scans(sequence, complete, FolderScanProvider(sequence, complete, scan_files), options);
}

}  // namespace relidar::folder
