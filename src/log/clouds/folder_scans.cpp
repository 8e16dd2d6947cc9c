// SPDX-License-Identifier: Apache-2.0
// Reads the scans of a plain folder. A scan file contains rays (npz, EXR) or points.
// Points are assigned to rays. If rings or beams are unknown, they are first estimated
// from a few scans of each LiDAR.
#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <optional>

#include <fmt/format.h>

#include <relidar/base/arrays.hpp>
#include <relidar/base/error.hpp>

#include "base/median.hpp"
#include "base/progress_blocks.hpp"
#include "log/clouds/broken_scans.hpp"
#include "log/clouds/dropped_ray.hpp"
#include "log/clouds/file_order.hpp"
#include "log/clouds/folder_head.hpp"
#include "log/clouds/folder_points.hpp"
#include "log/clouds/head_spins.hpp"
#include "log/clouds/point_meaning.hpp"
#include "log/clouds/scan_npz.hpp"
#include "log/clouds/thinned_cloud.hpp"

namespace relidar::folder {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kSamples = 6;  // number of scans per LiDAR that are used to estimate its beams
// sweep period in seconds that is assumed if the log has only one frame
constexpr double kUsualPeriod_s = 0.1;

/// Counts the points that are the first return of their ray. Comparing this count with
/// the finished scan shows how many points were lost.
std::size_t count_first_returns(const Points& points) {
    std::size_t n = 0;
    for (std::size_t i = 0; i < points.size(); ++i) {
        const float range_m = glm::length(points.position_m[i]);
        const bool is_first = points.return_number.empty() || points.return_number[i] == 1;
        n += is_first && range_m >= kNearestReturn_m;
    }
    return n;
}

/// How the points of one LiDAR are converted to scans.
struct Plan {
    /// true if points are assigned to beams and columns; false if each point becomes a
    /// ray
    bool ordered = false;
    /// true if the points in the files have ring numbers, and if they have times
    bool has_rings = false, has_times = false;
    bool undo = false;  ///< true: motion compensation is undone
    /// [rings] beam of each ring number in the files; kNoBeam: points of this ring are
    /// ignored
    std::vector<std::uint16_t> beam_of_ring;
    /// Order of the points in the files. Set if the points have no ring numbers, but
    /// their order shows the rings.
    std::optional<FileOrder> order;
};

/// Reads the scans of a folder from their files.
class FileScans : public ScanSource {
public:
    FileScans(const Sequence& sequence, const Head& head, const std::vector<fs::path>& files)
        : sequence_(sequence), head_(head), files_(files) {}

    std::string name(std::size_t index) const override { return files_[index].string(); }
    bool has_points(std::size_t index) const override { return !is_image_file(files_[index]); }
    Points points(std::size_t index) const override {
        const PointTable table = read_point_file(files_[index], head_.units.columns);
        check_deskewed(table.is_deskewed, head_, name(index));
        return make_points(table, head_.units, sequence_.frames[index].time_s, name(index));
    }
    Scan rays(std::size_t index) const override {
        const Frame& frame = sequence_.frames[index];
        const ImageSource source{head_, head_.lidars[std::size_t(frame.lidar)], sequence_.get_lidar(frame),
                                 frame.time_s};
        return files_[index].extension() == ".exr" ? read_scan_exr(files_[index], source)
                                                   : read_scan_npz(files_[index], source);
    }

private:
    const Sequence& sequence_;
    const Head& head_;
    const std::vector<fs::path>& files_;
};

class Reader {
public:
    Reader(Sequence& sequence, const Head& head, const ScanSource& source, bool has_poses,
           BrokenScans& broken)
        : sequence_(sequence),
          head_(head),
          source_(source),
          has_poses_(has_poses),
          broken_(broken),
          plans_(head.lidars.size()),
          left_out_(sequence.frames.size(), 0),
          n_first_(sequence.frames.size(), 0),
          behind_(sequence.frames.size(), 0) {}

    void find_sensors() {
        for (std::size_t l = 0; l < plans_.size(); ++l) {
            std::vector<std::size_t> with_points;  // frames with points
            for (std::size_t i = 0; i < sequence_.frames.size(); ++i)
                if (sequence_.frames[i].lidar == int(l) && source_.has_points(i)) with_points.push_back(i);
            if (sequence_.lidars[l].sensor.name.empty()) sequence_.lidars[l].sensor.name = sequence_.name;
            if (with_points.empty()) check_rays(l);
            else plan_lidar_conversion(l, with_points);
        }
        const auto stands = [&](const Plan& plan) { return !plan.undo; };
        sequence_.rolling_shutter =
            !head_.motion_compensated || std::none_of(plans_.begin(), plans_.end(), stands);
    }

    void read(std::size_t index) {
        Frame& frame = sequence_.frames[index];
        if (!source_.has_points(index)) {
            frame.scan = source_.rays(index);
            return;
        }
        const Plan& plan = plans_[std::size_t(frame.lidar)];
        const SpinningSensor& sensor = sequence_.get_lidar(frame).sensor;
        const auto sample = samples_.find(index);
        Points points = sample == samples_.end() ? read_points(index, plan.undo) : std::move(sample->second);
        if (plan.has_rings == points.ring.empty() || plan.has_times == points.time_offset_s.empty())
            throw DataError(fmt::format(
                "{}: its points have {} and {}, unlike the points of other scans of this LiDAR; expected the "
                "same fields in all scans",
                source_.name(index), points.ring.empty() ? "no rings" : "rings",
                points.time_offset_s.empty() ? "no times" : "times"));
        if (!plan.ordered) {
            frame.scan = make_unordered_scan(points);
            return;
        }
        if (plan.order) plan.order->assign_ring_numbers(points);
        if (plan.has_rings || plan.order) points = renumber_rings(points, plan, index);
        else recover_rings(points, sensor.beams);
        frame.scan = make_spinning_scan(points, sensor, make_uniform_sweep(points, sensor));
        n_first_[index] = count_first_returns(points);
        behind_[index] = n_first_[index] - std::min(n_first_[index], frame.scan.count_returns());
    }

    void report_skipped_values() {
        const auto sum = [](const std::vector<std::size_t>& counts) {
            return std::reduce(counts.begin(), counts.end());
        };
        if (const std::size_t n = sum(left_out_); n > 0)
            note(fmt::format("{} points are skipped, because the fitted sensor has no beam for their rings",
                             n));
        if (const std::size_t n = sum(behind_), all = sum(n_first_); n > 0)
            note(
                fmt::format("{} of {} points ({:.2g} %) are skipped, because their ray has a nearer point "
                            "and no neighbouring ray is free",
                            n, all, 100.0 * double(n) / double(all)));
    }

private:
    Sequence& sequence_;
    const Head& head_;
    const ScanSource& source_;
    const bool has_poses_;
    BrokenScans& broken_;
    std::vector<Plan> plans_;  ///< [lidars] settings for converting the points of each LiDAR
    /// [frames] points that were read to estimate the beams, so that they are not read
    /// again
    std::map<std::size_t, Points> samples_;
    std::vector<std::size_t> left_out_;  ///< [frames] number of ignored points
    std::vector<std::size_t> n_first_;   ///< [frames] number of first returns
    /// [frames] number of first returns that were lost, because their ray already had a
    /// point
    std::vector<std::size_t> behind_;

    void note(const std::string& text) {
        if (std::find(sequence_.notes.begin(), sequence_.notes.end(), text) == sequence_.notes.end())
            sequence_.notes.push_back(text);
    }
    void note(std::size_t lidar, const std::string& text) {
        const std::string& name = sequence_.lidars[lidar].name;
        note(name.empty() ? text : fmt::format("LiDAR '{}': {}", name, text));
    }

    Points read_points(std::size_t index, bool undo) const {
        const Frame& frame = sequence_.frames[index];
        Points points = source_.points(index);
        if (undo && !points.time_offset_s.empty())
            undo_motion_compensation(points, sequence_.world_from_sensor(frame.lidar), frame.time_s);
        return points;
    }

    /// Returns the duration of a revolution as stated by the user. If it is not stated,
    /// returns the median time between frames of the LiDAR.
    double estimate_frame_step_s(std::size_t lidar) const {
        if (head_.lidars[lidar].turn_s > 0.0) return head_.lidars[lidar].turn_s;
        std::vector<double> steps;
        double before_s = NAN;
        for (const Frame& frame : sequence_.frames) {
            if (frame.lidar != int(lidar)) continue;
            if (frame.time_s > before_s) steps.push_back(frame.time_s - before_s);
            before_s = frame.time_s;
        }
        return steps.empty() ? kUsualPeriod_s : compute_median(std::move(steps));
    }

    /// Sets the sweep period of a LiDAR whose files store rays instead of points. A LiDAR
    /// with unknown beams is treated as not rotating (period 0).
    void check_rays(std::size_t lidar) {
        SpinningSensor& sensor = sequence_.lidars[lidar].sensor;
        if (!head_.lidars[lidar].has_beams) sensor.period_s = 0.0;
        else if (sensor.period_s == 0.0) sensor.period_s = estimate_frame_step_s(lidar);
    }

    void plan_lidar_conversion(std::size_t lidar, const std::vector<std::size_t>& frames) {
        Plan& plan = plans_[lidar];
        std::vector<Points> samples;
        std::vector<std::size_t> of_sample;  // frame of each sample
        const auto add_sample = [&](std::size_t index) {
            broken_.attempt(index, [&] {
                samples.push_back(read_points(index, head_.motion_compensated && has_poses_));
                of_sample.push_back(index);
            });
        };
        const std::size_t n = std::min(kSamples, frames.size());
        for (std::size_t k = 0; k < n; ++k) add_sample(frames[k * frames.size() / n]);
        for (std::size_t k = 0; samples.empty() && k < frames.size(); ++k) add_sample(frames[k]);
        if (samples.empty()) broken_.add_broken_scan_notes(sequence_, broken_.size());
        plan.has_rings = !samples[0].ring.empty();
        plan.has_times = !samples[0].time_offset_s.empty();
        plan.undo = head_.motion_compensated && has_poses_ && plan.has_times;
        SpinningSensor& sensor = sequence_.lidars[lidar].sensor;
        if (sensor.period_s == 0.0 || !head_.lidars[lidar].has_beams)
            sensor.period_s = estimate_frame_step_s(lidar);
        if (head_.lidars[lidar].has_beams) use_stored_beams(lidar);
        else if (head_.lidars[lidar].spins) fit_beams(lidar, samples);
        if (!plan.ordered) sensor.period_s = 0.0;
        if (plan.ordered && !plan.has_times && !head_.motion_compensated)
            note(lidar,
                 "the points have no times; their times are computed from their azimuths for a head that "
                 "faces forward at the time of the frame");
        if (head_.motion_compensated && !plan.undo)
            note(lidar,
                 "the scans are motion-compensated, which cannot be undone without times of points and "
                 "poses; all rays start at the position of the sensor at the time of the frame");
        for (std::size_t k = 0; k < samples.size(); ++k) {
            // Removes ring numbers that were estimated only to fit the sensor.
            if (!plan.has_rings) samples[k].ring.clear();
            samples_.emplace(of_sample[k], std::move(samples[k]));
        }
    }

    void use_stored_beams(std::size_t lidar) {
        Plan& plan = plans_[lidar];
        const std::size_t n = sequence_.lidars[lidar].sensor.beams.size();
        plan.ordered = true;
        for (std::size_t k = 0; k < n; ++k)
            plan.beam_of_ring.push_back(std::uint16_t(head_.lidars[lidar].lowest_first ? n - 1 - k : k));
        if (!plan.has_rings)
            note(lidar,
                 "the points have no rings; each point is assigned to the beam with the nearest "
                 "elevation");
    }

    void fit_beams(std::size_t lidar, std::vector<Points>& samples) {
        Plan& plan = plans_[lidar];
        SpinningSensor& sensor = sequence_.lidars[lidar].sensor;
        if (!plan.has_rings && !find_rings(lidar, samples)) {
            note(lidar,
                 "the points have no rings, and neither their order nor their elevations show the rings; "
                 "therefore dropped rays and the order of the rays in an image are unknown" +
                     suggest_sensor_setting(lidar));
            return;
        }
        const double step_s = sensor.period_s;
        std::optional<SpinningSensor> found = fit_sensor_to_samples(lidar, samples, step_s);
        std::string why = found ? explain_missing_head(samples, *found, step_s) : "";
        if (found && why.empty() && !plan.has_rings) why = explain_thinning(samples, *found);
        if (!why.empty()) {
            note(lidar,
                 fmt::format(
                     "{}; therefore no spinning sensor is used: each point becomes one ray, and dropped "
                     "rays are unknown{}",
                     why, plan.has_rings ? "" : suggest_sensor_setting(lidar)));
            found = std::nullopt;
        }
        if (!found) plan.order.reset();
        if (!found) return;
        found->name = sensor.name;
        found->min_range_m = sensor.min_range_m;
        found->max_range_m = sensor.max_range_m;
        found->divergence_rad = sensor.divergence_rad;
        sensor = *found;
        plan.ordered = true;
        note(lidar, fmt::format("a sensor with {} beams and {} columns was fitted to the points{}",
                                found->beams.size(), found->columns,
                                plan.order ? ", which have no rings; their order in the file shows the "
                                             "rings"
                                : !plan.has_rings ? ", which have no rings"
                                                  : ""));
    }

    /// Sets ring numbers of points that have none, from their elevations or from their
    /// order. Returns false if neither shows the rings.
    bool find_rings(std::size_t lidar, std::vector<Points>& samples) {
        // Elevations are tried first. The rings of an Ouster begin at different azimuths,
        // so the order of its points cannot show them.
        if (const std::vector<Beam> beams = find_beams(samples); !beams.empty()) {
            for (Points& sample : samples) recover_rings(sample, beams);
            return true;
        }
        const FileOrder order(samples);
        if (!order.has_ring_numbers()) return false;
        for (Points& sample : samples) order.assign_ring_numbers(sample);
        plans_[lidar].order = order;
        return true;
    }

    /// Returns a hint that the user can set the sensor in sequence.json. Returns an empty
    /// string for a log without this file.
    std::string suggest_sensor_setting(std::size_t lidar) const {
        return head_.lidars[lidar].is_guessed ? ""
                                              : "; use \"sensor\" of the LiDAR in sequence.json to set its "
                                                "beams";
    }

    std::optional<SpinningSensor> fit_sensor_to_samples(std::size_t lidar, const std::vector<Points>& samples,
                                                        double period_s) {
        try {
            const FittedSensor fit = fit_sensor(samples, period_s);
            if (fit.sensor.beams.size() * std::size_t(fit.sensor.columns) > kMaxRays)
                throw DataError(
                    fmt::format("the fitted sensor has {} beams and {} columns, expected at "
                                "most {} rays",
                                fit.sensor.beams.size(), fit.sensor.columns, kMaxRays));
            plans_[lidar].beam_of_ring = fit.beam_of_ring;
            return fit.sensor;
        } catch (const DataError& error) {
            if (head_.lidars[lidar].is_guessed) {
                note(lidar,
                     fmt::format("{}; therefore each point becomes one ray, and dropped rays are unknown",
                                 error.what()));
                return std::nullopt;
            }
            throw DataError(
                fmt::format("{}: LiDAR '{}': {}; use \"spins\": false in sequence.json to read each point "
                            "as one ray",
                            sequence_.source, sequence_.lidars[lidar].name, error.what()));
        }
    }

    /// Replaces ring numbers of the file by beam numbers. Removes points of rings without
    /// a beam.
    Points renumber_rings(const Points& points, const Plan& plan, std::size_t index) {
        Points kept;
        for (std::size_t p = 0; p < points.size(); ++p) {
            const std::uint16_t ring = points.ring[p],
                                beam = ring < plan.beam_of_ring.size() ? plan.beam_of_ring[ring] : kNoBeam;
            if (beam == kNoBeam && head_.lidars[std::size_t(sequence_.frames[index].lidar)].has_beams)
                throw DataError(
                    fmt::format("{}: a point has ring {}, expected the number of one of {} "
                                "beams",
                                source_.name(index), ring, plan.beam_of_ring.size()));
            if (beam == kNoBeam) {
                ++left_out_[index];
                continue;
            }
            kept.position_m.push_back(points.position_m[p]);
            kept.intensity.push_back(points.intensity[p]);
            kept.ring.push_back(beam);
            if (!points.time_offset_s.empty()) kept.time_offset_s.push_back(points.time_offset_s[p]);
            if (!points.return_number.empty()) kept.return_number.push_back(points.return_number[p]);
        }
        return kept;
    }
};

/// Reads the points of a few files, evenly spread over the log. Skips unreadable files,
/// because the error is reported later, when all scans are read.
std::vector<PointTable> sample_tables(const std::vector<fs::path>& files,
                                      const std::vector<std::string>& columns) {
    std::vector<fs::path> with_points;
    std::ranges::copy_if(files, std::back_inserter(with_points), is_point_file);
    std::vector<PointTable> samples;
    const std::size_t n = std::min(kSamples, with_points.size());
    for (std::size_t k = 0; k < n; ++k) {
        try {
            samples.push_back(read_point_file(with_points[k * with_points.size() / n], columns));
        } catch (const DataError&) {
            continue;
        }
    }
    return samples;
}

/// Estimates the intensity scale of a log from a few of its .npz files.
IntensityScale scale_of_images(const std::vector<fs::path>& files) {
    std::vector<fs::path> images;
    std::ranges::copy_if(files, std::back_inserter(images),
                         [](const fs::path& file) { return file.extension() == ".npz"; });
    std::vector<double> intensities;
    const std::size_t n = std::min(kSamples, images.size());
    for (std::size_t k = 0; k < n; ++k) {
        try {
            const std::vector<NamedArray> arrays = read_npz(images[k * images.size() / n]);
            if (const NamedArray* array = find_array(arrays, "intensity"))
                std::ranges::copy(array->as_double(), std::back_inserter(intensities));
        } catch (const DataError&) {
            continue;  // the error is reported when the scan is read
        }
    }
    return find_scale(intensities);
}

/// Estimates units that sequence.json does not contain from the points of some scans. If
/// the intensity scale is ambiguous, it stays unset, and intensities above 1 cause an
/// error later.
void find_units(Head& head, const std::vector<fs::path>& files, std::vector<std::string>& notes) {
    const std::vector<PointTable> samples = sample_tables(files, head.units.columns);
    PointMeaning meaning = find_meaning(samples);
    if (samples.empty() && !head.units.intensity_max) meaning.scale = scale_of_images(files);
    head.units.intensity_field = meaning.intensity_field;
    head.units.no_return = meaning.no_return;
    std::erase(meaning.notes, meaning.scale.about);
    if (!head.units.intensity_max && meaning.scale.is_sure && meaning.scale.max > 1.0) {
        head.units.intensity_max = meaning.scale.max;
        notes.push_back(meaning.scale.about + "; use intensity_max in sequence.json to set another scale");
    }
    notes.insert(notes.end(), meaning.notes.begin(), meaning.notes.end());
}

/// Returns the indices of the frames whose scans will be read.
/// @param max_scans  maximum number of scans per LiDAR
std::vector<std::size_t> select_frames_to_read(const Sequence& sequence, int max_scans) {
    std::vector<std::vector<std::size_t>> own(sequence.lidars.size());
    for (std::size_t i = 0; i < sequence.frames.size(); ++i)
        own[std::size_t(sequence.frames[i].lidar)].push_back(i);
    std::vector<std::size_t> all;
    for (const std::vector<std::size_t>& frames : own) {
        const std::size_t n = max_scans > 0 ? std::min(std::size_t(max_scans), frames.size()) : frames.size();
        for (std::size_t k = 0; k < n; ++k) all.push_back(frames[k * frames.size() / n]);
    }
    std::ranges::sort(all);
    return all;
}

}  // namespace

void read_scans(Sequence& sequence, const Head& head, const ScanSource& source,
                const DatasetOptions& options) {
    BrokenScans broken(options.skip_broken);
    Reader reader(sequence, head, source, options.poses_file != kNoPoses, broken);
    reader.find_sensors();
    const std::vector<std::size_t> frames = select_frames_to_read(sequence, options.max_scans);
    for_each_with_progress(frames.size(), options.progress, "reading scans", [&](std::size_t index) {
        broken.attempt(frames[index], [&] { reader.read(frames[index]); });
    });
    reader.report_skipped_values();
    broken.leave_out(sequence);
}

void read_scans(Sequence& sequence, const Head& head, const std::vector<fs::path>& files,
                const DatasetOptions& options) {
    Head complete = head;
    find_units(complete, files, sequence.notes);
    read_scans(sequence, complete, FileScans(sequence, complete, files), options);
}

}  // namespace relidar::folder
