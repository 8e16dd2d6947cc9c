// SPDX-License-Identifier: Apache-2.0
// Scans of a plain folder: rays as npz and EXR have them, or points that are put on the rays that took them. What points do not say, rings
// and beams, is found from a few scans of each LiDAR first.
#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/error.hpp>

#include "core/progress_blocks.hpp"
#include "dataset/broken_scans.hpp"
#include "dataset/folder_head.hpp"
#include "dataset/point_table.hpp"
#include "dataset/scan_npz.hpp"

namespace relidar::folder {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kSamples = 6;     // scans of a LiDAR from which its beams are found
constexpr double kUsualPeriod_s = 0.1;  // of a sweep, where there is one frame alone
constexpr double kFarthestCoordinate_m = 1e6;

/// How the points of a LiDAR become scans.
struct Plan {
    bool ordered = false;                       ///< by beams and columns
    bool has_rings = false, has_times = false;  ///< in its files
    bool undo = false;                          ///< motion compensation
    std::vector<std::uint16_t> beam_of_ring;    ///< kNoBeam: points of the ring are left out
};

std::size_t count_points(const PointTable& table, const std::vector<double>& x) {
    return table.n - std::size_t(std::count_if(x.begin(), x.end(), [](double v) { return std::isnan(v); }));
}

/// Points as a file has them. A point whose x is no number is a ray without a return, as PCD has it.
ScanPoints points_of(const PointTable& table, const PointUnits& units, double time_s, const std::string& where) {
    const std::vector<double>*x = table.find({"x"}), *y = table.find({"y"}), *z = table.find({"z"});
    if (!x || !y || !z) throw DataError(fmt::format("{}: no field {}, expected x, y and z", where, !x ? "x" : !y ? "y" : "z"));
    const std::vector<double>*intensity = table.find({"intensity"}), *ring = table.find({"ring", "channel"}),
          *time = table.find({"time", "t", "timestamp", "offset_time"}), *number = table.find({"return", "return_number"});
    ScanPoints points;
    points.point_m.reserve(count_points(table, *x));
    for (std::size_t i = 0; i < table.n; ++i) {
        if (std::isnan((*x)[i])) continue;
        const auto of_point = [&] { return fmt::format("{}: point {}", where, i); };
        const glm::dvec3 p((*x)[i], (*y)[i], (*z)[i]);
        if (!(std::abs(p.x) <= kFarthestCoordinate_m && std::abs(p.y) <= kFarthestCoordinate_m && std::abs(p.z) <= kFarthestCoordinate_m))
            throw DataError(fmt::format("{}: ({}, {}, {}), expected metres within {}", of_point(), p.x, p.y, p.z, kFarthestCoordinate_m));
        points.point_m.emplace_back(p);
        points.intensity.push_back(intensity ? unit_intensity((*intensity)[i], units, of_point()) : 0.0f);
        if (ring) points.ring.push_back(ring_number((*ring)[i], of_point()));
        if (time) points.time_offset_s.push_back(time_offset((*time)[i], units, time_s, of_point()));
        if (number) {
            if (!((*number)[i] >= 0.0 && (*number)[i] < 8.0))
                throw DataError(fmt::format("{}: return {}, expected 0 (the strongest) to 7", of_point(), (*number)[i]));
            points.return_number.push_back(std::uint8_t((*number)[i]));
        }
    }
    return points;
}

class Reader {
public:
    Reader(Sequence& sequence, const Head& head, const std::vector<fs::path>& files, bool has_poses, BrokenScans& broken)
        : sequence_(sequence),
          head_(head),
          files_(files),
          has_poses_(has_poses),
          broken_(broken),
          plans_(head.lidars.size()),
          left_out_(files.size(), 0) {}

    void find_sensors() {
        for (std::size_t l = 0; l < plans_.size(); ++l) {
            std::vector<std::size_t> with_points;  // frames
            for (std::size_t i = 0; i < files_.size(); ++i)
                if (sequence_.frames[i].lidar == int(l) && is_point_file(files_[i])) with_points.push_back(i);
            if (sequence_.lidars[l].sensor.name.empty()) sequence_.lidars[l].sensor.name = sequence_.name;
            if (with_points.empty())
                check_rays(l);
            else
                make_plan(l, with_points);
        }
        const auto stands = [&](const Plan& plan) { return !plan.undo; };
        sequence_.rolling_shutter = !head_.motion_compensated || std::none_of(plans_.begin(), plans_.end(), stands);
    }

    void read(std::size_t i) {
        Frame& frame = sequence_.frames[i];
        if (is_image_file(files_[i])) {
            const ImageSource source{head_, head_.lidars[std::size_t(frame.lidar)], sequence_.lidar_of(frame), frame.time_s};
            frame.scan = files_[i].extension() == ".exr" ? read_scan_exr(files_[i], source) : read_scan_npz(files_[i], source);
            return;
        }
        const Plan& plan = plans_[std::size_t(frame.lidar)];
        const SpinningSensor& sensor = sequence_.lidar_of(frame).sensor;
        ScanPoints points = read_points(i, plan.undo);
        if (plan.has_rings == points.ring.empty() || plan.has_times == points.time_offset_s.empty())
            throw DataError(fmt::format("{}: its points {} rings and {} times, expected what the other scans of the LiDAR have",
                                        files_[i].string(), points.ring.empty() ? "lack" : "have",
                                        points.time_offset_s.empty() ? "lack" : "have"));
        if (!plan.ordered) {
            frame.scan = unordered_scan(points);
            return;
        }
        if (plan.has_rings)
            points = renumbered(points, plan, i);
        else
            recover_rings(points, sensor.beams);
        frame.scan = spinning_scan(points, sensor, even_sweep(points, sensor));
    }

    void tell_left_out() {
        std::size_t n = 0;
        for (const std::size_t k : left_out_) n += k;
        if (n > 0) note(fmt::format("{} points of rings that the fitted scans do not have are left out", n));
    }

private:
    Sequence& sequence_;
    const Head& head_;
    const std::vector<fs::path>& files_;
    const bool has_poses_;
    BrokenScans& broken_;
    std::vector<Plan> plans_;            ///< [lidars]
    std::vector<std::size_t> left_out_;  ///< [frames] points

    void note(const std::string& text) {
        if (std::find(sequence_.notes.begin(), sequence_.notes.end(), text) == sequence_.notes.end()) sequence_.notes.push_back(text);
    }
    void note(std::size_t lidar, const std::string& text) {
        const std::string& name = sequence_.lidars[lidar].name;
        note(name.empty() ? text : fmt::format("LiDAR '{}': {}", name, text));
    }

    ScanPoints read_points(std::size_t i, bool undo) const {
        const Frame& frame = sequence_.frames[i];
        ScanPoints points = points_of(read_point_file(files_[i], head_.units.columns), head_.units, frame.time_s, files_[i].string());
        if (undo && !points.time_offset_s.empty()) undo_compensation(points, sequence_.world_from_sensor(frame.lidar), frame.time_s);
        return points;
    }

    /// Between the frames of a LiDAR, in the middle.
    double frame_step_s(std::size_t lidar) const {
        std::vector<double> steps;
        double before_s = NAN;
        for (const Frame& frame : sequence_.frames) {
            if (frame.lidar != int(lidar)) continue;
            if (frame.time_s > before_s) steps.push_back(frame.time_s - before_s);
            before_s = frame.time_s;
        }
        if (steps.empty()) return kUsualPeriod_s;
        std::nth_element(steps.begin(), steps.begin() + std::ptrdiff_t(steps.size() / 2), steps.end());
        return steps[steps.size() / 2];
    }

    /// A LiDAR whose scans are rays spins where its sensor is given.
    void check_rays(std::size_t l) {
        SpinningSensor& sensor = sequence_.lidars[l].sensor;
        if (!head_.lidars[l].has_beams)
            sensor.period_s = 0.0;
        else if (sensor.period_s == 0.0)
            sensor.period_s = frame_step_s(l);
    }

    void make_plan(std::size_t l, const std::vector<std::size_t>& frames) {
        Plan& plan = plans_[l];
        std::vector<ScanPoints> samples;
        const std::size_t n = std::min(kSamples, frames.size());
        for (std::size_t k = 0; k < n; ++k) {
            const std::size_t i = frames[k * frames.size() / n];
            broken_.attempt(i, [&] { samples.push_back(read_points(i, head_.motion_compensated && has_poses_)); });
        }
        for (std::size_t k = 0; samples.empty() && k < frames.size(); ++k)
            broken_.attempt(frames[k], [&] { samples.push_back(read_points(frames[k], head_.motion_compensated && has_poses_)); });
        if (samples.empty()) broken_.tell(sequence_, broken_.size());
        plan.has_rings = !samples[0].ring.empty();
        plan.has_times = !samples[0].time_offset_s.empty();
        plan.undo = head_.motion_compensated && has_poses_ && plan.has_times;
        SpinningSensor& sensor = sequence_.lidars[l].sensor;
        if (sensor.period_s == 0.0 || !head_.lidars[l].has_beams) sensor.period_s = frame_step_s(l);
        if (head_.lidars[l].has_beams)
            take_beams(l);
        else if (head_.lidars[l].spins)
            fit_beams(l, samples);
        if (!plan.ordered) sensor.period_s = 0.0;
        if (plan.ordered && !plan.has_times && !head_.motion_compensated)
            note(l, "points have no times: a ray was fired when a head that faces forward at the frame's time got there");
        if (head_.motion_compensated && !plan.undo)
            note(l,
                 "scans are motion-compensated, and points have no times (or the log no poses) to undo it: rays start at the sensor of the "
                 "frame's time");
    }

    void take_beams(std::size_t l) {
        Plan& plan = plans_[l];
        const std::size_t n = sequence_.lidars[l].sensor.beams.size();
        plan.ordered = true;
        for (std::size_t k = 0; k < n; ++k) plan.beam_of_ring.push_back(std::uint16_t(head_.lidars[l].lowest_first ? n - 1 - k : k));
        if (!plan.has_rings) note(l, "points have no rings: each is taken for one of the beam that passes nearest");
    }

    void fit_beams(std::size_t l, std::vector<ScanPoints>& samples) {
        Plan& plan = plans_[l];
        SpinningSensor& sensor = sequence_.lidars[l].sensor;
        if (!plan.has_rings) {
            const std::vector<Beam> beams = find_beams(samples);
            if (beams.empty()) {
                note(l,
                     "points have no rings, and their elevations show none: rays that were dropped are unknown, and so is the order of an "
                     "image");
                return;
            }
            for (ScanPoints& sample : samples) recover_rings(sample, beams);
        }
        SpinningSensor found = fitted(l, samples, sensor.period_s);
        found.name = sensor.name;
        found.min_range_m = sensor.min_range_m;
        found.max_range_m = sensor.max_range_m;
        found.divergence_rad = sensor.divergence_rad;
        sensor = found;
        plan.ordered = true;
        note(l, fmt::format("{} beams x {} columns are fitted to its points{}", found.beams.size(), found.columns,
                            plan.has_rings ? "" : ", which have no rings"));
    }

    SpinningSensor fitted(std::size_t l, const std::vector<ScanPoints>& samples, double period_s) {
        try {
            const FittedSensor fit = fit_sensor(samples, period_s);
            if (fit.sensor.beams.size() * std::size_t(fit.sensor.columns) > kMaxRays)
                throw DataError(
                    fmt::format("{} beams x {} columns, expected at most {} rays", fit.sensor.beams.size(), fit.sensor.columns, kMaxRays));
            plans_[l].beam_of_ring = fit.beam_of_ring;
            return fit.sensor;
        } catch (const DataError& error) {
            throw DataError(fmt::format("{}: LiDAR '{}': {}; \"spins\": false in sequence.json takes points as they are", sequence_.source,
                                        sequence_.lidars[l].name, error.what()));
        }
    }

    /// Rings as relidar counts them.
    ScanPoints renumbered(const ScanPoints& points, const Plan& plan, std::size_t i) {
        ScanPoints kept;
        for (std::size_t p = 0; p < points.size(); ++p) {
            const std::uint16_t ring = points.ring[p], beam = ring < plan.beam_of_ring.size() ? plan.beam_of_ring[ring] : kNoBeam;
            if (beam == kNoBeam && head_.lidars[std::size_t(sequence_.frames[i].lidar)].has_beams)
                throw DataError(
                    fmt::format("{}: a point of ring {}, expected one of {} beams", files_[i].string(), ring, plan.beam_of_ring.size()));
            if (beam == kNoBeam) {
                ++left_out_[i];
                continue;
            }
            kept.point_m.push_back(points.point_m[p]);
            kept.intensity.push_back(points.intensity[p]);
            kept.ring.push_back(beam);
            if (!points.time_offset_s.empty()) kept.time_offset_s.push_back(points.time_offset_s[p]);
            if (!points.return_number.empty()) kept.return_number.push_back(points.return_number[p]);
        }
        return kept;
    }
};

}  // namespace

void read_scans(Sequence& sequence, const Head& head, const std::vector<fs::path>& files, const DatasetOptions& options) {
    BrokenScans broken(options.skip_broken);
    Reader reader(sequence, head, files, options.poses_file != kNoPoses, broken);
    reader.find_sensors();
    for_each_told(files.size(), options.progress, "reading scans", [&](std::size_t i) { broken.attempt(i, [&] { reader.read(i); }); });
    reader.tell_left_out();
    broken.leave_out(sequence);
}

}  // namespace relidar::folder
