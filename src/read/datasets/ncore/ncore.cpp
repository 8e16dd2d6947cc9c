// SPDX-License-Identifier: Apache-2.0
// Reads sequences of NVIDIA's NCore, version 4. The vehicle frame is the frame "rig", or
// the frame that moves with the first LiDAR. The world frame is the frame "world".
#include "read/readers.hpp"

#include <algorithm>
#include <map>
#include <utility>

#include <fmt/format.h>

#include <relidar/log/log_time.hpp>
#include <relidar/read/clouds.hpp>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "log/frames/match_sweeps.hpp"
#include "read/datasets/ncore/ncore_scans.hpp"
#include "read/files/point_table.hpp"
#include "read/scans/pose_files.hpp"
#include "read/scans/sweep_poses.hpp"

namespace relidar {
namespace ncore {
namespace {

namespace fs = std::filesystem;

constexpr const char* kWorld = "world";
constexpr const char* kRig = "rig";
// A sweep belongs to the sweep of the first LiDAR that is nearer than this share of the
// time between sweeps.
constexpr double kMaxSweepGap = 0.6;
// If the rays differ more from the model, the beams are fitted to the points.
constexpr double kMaxMisfit_rad = kPi / 180.0;
constexpr double kDegrees = 180.0 / kPi;
constexpr std::size_t kSampleFrames = 4;  // frames of a LiDAR that show its beams
constexpr std::size_t kLongestId = 200;

/// A LiDAR that is fixed to the vehicle.
struct NcoreLidar {
    Component component;
    std::vector<StoredFrame> frames;
};

class NcoreLoader {
public:
    NcoreLoader(const fs::path& path, const DatasetOptions& options)
        : options_(options), sequence_(path), graph_(sequence_, sequence_.notes) {
        log_.name = "NCore " + sequence_.id;
        log_.source = path.string();
    }

    Log load() {
        find_lidars();
        if (options_.poses_file.empty() && !vehicle_path_)
            fail("{}: no poses join the frames '{}' and '{}'; use dataset.poses=FILE or dataset.poses=none",
                 sequence_.place(), quote(vehicle_), kWorld);
        add_frames();
        read_boxes();
        log_.conventions = fmt::format(
            "Vehicle frame: '{}' of NCore, x forward, y left, z up, in metres. World frame: '{}' of NCore. "
            "Times are seconds after the start of the sequence. The time of a frame is the middle of its "
            "sweep. Points are not motion-compensated.",
            quote(vehicle_), kWorld);
        set_log_start(log_, 1000 * sequence_.start_us, "on the clock of the sequence");
        read::replace_poses(log_, options_);
        centre_log(log_);
        read_scans();
        log_.notes.insert(log_.notes.begin(), sequence_.notes.begin(), sequence_.notes.end());
        return std::move(log_);
    }

private:
    const DatasetOptions& options_;
    NcoreSequence sequence_;
    const PoseGraph graph_;
    Log log_;
    std::string vehicle_ = kRig;
    std::optional<PoseGraph::Path> vehicle_path_;  ///< from the vehicle to the world
    std::vector<NcoreLidar> lidars_;
    std::vector<ScanLocation> scans_;  ///< [frames]

    /// Returns the last frame on the way from a LiDAR to the world that moves with the
    /// LiDAR.
    std::string carrier_of(const std::string& lidar) const {
        const auto path = graph_.find_path(lidar, kWorld);
        if (!path) return lidar;
        const auto moving =
            std::ranges::find_if(*path, [](const PoseGraph::Step& step) { return !step.edge->is_fixed; });
        return moving == path->end() ? lidar : moving->begin();
    }

    /// Lists the LiDARs with frames that are fixed to the vehicle.
    void find_lidars() {
        const std::vector<Component> components = sequence_.list_components("lidars");
        if (!graph_.has_frame(kRig) && !components.empty()) vehicle_ = carrier_of(components.front().name);
        vehicle_path_ = graph_.find_path(vehicle_, kWorld);
        log_.lidars.clear();
        for (const Component& component : components) {
            const auto mounting = graph_.find_path(component.name, vehicle_);
            std::vector<StoredFrame> frames = list_stored_frames(component);
            if (!mounting || !PoseGraph::is_fixed(*mounting))
                sequence_.notes.push_back(
                    fmt::format("the LiDAR {} is not read, because no fixed pose joins it to '{}'",
                                quote(component.name), quote(vehicle_)));
            else if (frames.empty())
                sequence_.notes.push_back(fmt::format("the LiDAR {} has no frames", quote(component.name)));
            else {
                lidars_.push_back({component, std::move(frames)});
                log_.lidars.push_back({component.name, {}, PoseGraph::pose_at(*mounting, 0.0)});
            }
        }
        if (lidars_.empty())
            fail("{}: no LiDAR can be read, expected one with frames and a pose on the vehicle",
                 sequence_.place());
        // A LiDAR needs a name only if the log has several or the user selected it.
        if (lidars_.size() == 1 && options_.lidars.empty()) log_.lidars[0].name = "";
    }

    /// Adds the sweeps of the first LiDAR as frames, and the simultaneous sweeps of the
    /// other LiDARs.
    void add_frames() {
        std::vector<double> main_s;  // times of the sweeps of the first LiDAR
        for (const StoredFrame& frame : lidars_[0].frames)
            main_s.push_back(sequence_.seconds_of(frame.middle_us()));
        std::vector<std::vector<std::optional<std::size_t>>> matches;  // [lidars][sweeps of the first LiDAR]
        for (const NcoreLidar& lidar : lidars_) {
            std::vector<double> times_s;
            for (const StoredFrame& frame : lidar.frames)
                times_s.push_back(sequence_.seconds_of(frame.middle_us()));
            matches.push_back(match_sweeps(main_s, times_s, kMaxSweepGap * median_interval_s(main_s)));
            const auto n =
                std::ranges::count_if(matches.back(), [](const auto& match) { return match.has_value(); });
            if (const std::size_t n_left = times_s.size() - std::size_t(n); n_left > 0)
                log_.notes.push_back(
                    fmt::format("{}: {} sweeps are skipped, because {} has no sweeps at similar times",
                                lidar.component.name, n_left, lidars_[0].component.name));
        }
        std::size_t n_without_pose = 0;
        for (std::size_t k = 0; k < main_s.size(); ++k) {
            if (!options_.frames.contains(int(k))) continue;
            if (options_.poses_file.empty() && !PoseGraph::is_known(*vehicle_path_, main_s[k])) {
                ++n_without_pose;
                continue;
            }
            const Pose pose = vehicle_path_ ? PoseGraph::pose_at(*vehicle_path_, main_s[k]) : Pose{};
            for (std::size_t l = 0; l < lidars_.size(); ++l) {
                if (!matches[l][k]) continue;
                add_frame(log_, int(k), main_s[k], pose, int(l));
                scans_.push_back({l, lidars_[l].frames[*matches[l][k]], lidars_[0].frames[k].middle_us()});
            }
        }
        if (n_without_pose > 0)
            log_.notes.push_back(fmt::format(
                "{} frames are skipped, because the sequence has no poses at their times", n_without_pose));
        if (scans_.empty() && n_without_pose > 0)
            fail("{}: the sequence has no poses at the times of the requested frames", sequence_.place());
        if (scans_.empty()) fail_empty_range(options_.frames, log_.name, 0, int(main_s.size()) - 1);
    }

    /// Reads the boxes near the times of the loaded frames.
    void read_boxes() {
        const std::vector<Component> components = sequence_.list_components("cuboids");
        if (components.empty() || !vehicle_path_) {
            log_.notes.push_back("this log has no labels");
            return;
        }
        for (std::size_t i = 1; i < components.size(); ++i)
            log_.notes.push_back(fmt::format("the boxes of {} are not read, only those of {}",
                                             quote(components[i].path), quote(components[0].path)));
        const ZarrJson attributes = components[0].attributes("cuboids");
        const JsonField root = attributes.root(), list = root.at("cuboid_track_observations");
        const std::vector<double>& times_s = log_.world_from_vehicle.time_s;
        const double margin_s = median_interval_s(times_s);
        std::map<std::string, std::optional<PoseGraph::Path>> paths;
        std::vector<BoxLabel> labels;
        std::size_t n_unknown = 0;
        for (std::size_t i = 0; i < list.size(); ++i) {
            const JsonField item = list.at(i), box = item.at("bbox3");
            const std::string frame = item.at("reference_frame_id").short_text(kLongestId);
            if (!paths.contains(frame)) paths[frame] = graph_.find_path(frame, kWorld);
            // The box was seen at time_s. Its pose is relative to `frame` at reference_s.
            const double time_s = sequence_.seconds_of(read_time_us(item.at("timestamp_us"))),
                         reference_s =
                             sequence_.seconds_of(read_time_us(item.at("reference_frame_timestamp_us")));
            const auto centre = box.at("centroid").numbers<3>(), size = box.at("dim").numbers<3>(),
                       angles = box.at("rot").numbers<3>();
            if (time_s < times_s.front() - margin_s || time_s > times_s.back() + margin_s) continue;
            if (!paths[frame]) {
                ++n_unknown;
                continue;
            }
            const Pose in_frame{make_rotation(angles[2], angles[1], angles[0]),
                                {centre[0], centre[1], centre[2]}};
            labels.push_back({item.at("track_id").short_text(kLongestId),
                              item.at("class_id").short_text(kLongestId),
                              {size[0], size[1], size[2]},
                              time_s,
                              PoseGraph::pose_at(*paths[frame], reference_s) * in_frame});
        }
        if (n_unknown > 0)
            log_.notes.push_back(fmt::format(
                "{} boxes are ignored, because no poses join their frame and the world", n_unknown));
        std::ranges::stable_sort(labels, {},
                                 [](const BoxLabel& label) { return std::pair(label.id, label.time_s); });
        // A track has one pose at a time.
        const auto repeated = std::ranges::unique(labels, [](const BoxLabel& first, const BoxLabel& second) {
            return first.id == second.id && first.time_s == second.time_s;
        });
        labels.erase(repeated.begin(), repeated.end());
        log_.boxes = build_tracks(labels);
    }

    std::vector<RayBundle> read_samples(std::size_t l) const {
        std::vector<const ScanLocation*> scans;
        for (const ScanLocation& scan : scans_)
            if (scan.lidar == l) scans.push_back(&scan);
        std::vector<RayBundle> samples;
        read::read_samples(
            scans.size(),
            [&](std::size_t i) {
                samples.push_back(read_ray_bundle(lidars_[l].component, scans[i]->frame, scans[i]->time_us));
            },
            kSampleFrames);
        return samples;
    }

    /// Returns the model of a LiDAR if its rays become an image: each ray has a row and a
    /// column of the model, and nearly its direction. Then sets the sensor of the LiDAR.
    std::optional<SpinningModel> choose_model(std::size_t l, read::LidarScanLayout& layout) {
        SpinningSensor& sensor = log_.lidars[l].sensor;
        const std::string& name = lidars_[l].component.name;
        sensor.name = fmt::format("{} of {}", name, log_.name);
        sensor.max_range_m = options_.max_range_m;
        std::optional<SpinningModel> model = read_model(sequence_, name);
        if (!model) return std::nullopt;
        const FittedBeams fitted = fit_beam_origins(read_samples(l), *model);
        model->beams = fitted.beams;
        const std::optional<SpinningSensor> model_sensor = to_sensor(*model);
        const bool fits = model_sensor && fitted.n_returns > 0 &&
                          std::min(fitted.model_misfit_rad, fitted.misfit_rad) < kMaxMisfit_rad;
        log_.notes.push_back(fmt::format(
            "{}: the rays differ by {:.3f} degrees (median) from NCore's model, and by {:.3f} degrees from "
            "beams whose directions and origins are fitted to the points; {}",
            name, fitted.model_misfit_rad * kDegrees, fitted.misfit_rad * kDegrees,
            !fits              ? "NCore's model is not used"
            : fitted.is_better ? "these beams are used"
                               : "NCore's model is used"));
        if (!fits) return std::nullopt;
        layout.has_beams = true;
        const std::string sensor_name = std::exchange(sensor, *model_sensor).name;
        sensor.name = sensor_name;
        sensor.max_range_m = options_.max_range_m;
        return model;
    }

    void read_scans() {
        read::ScanLayout layout{.lidars = std::vector<read::LidarScanLayout>(lidars_.size())};
        std::vector<std::optional<SpinningModel>> models;
        std::vector<Component> components;
        for (std::size_t l = 0; l < lidars_.size(); ++l) {
            models.push_back(choose_model(l, layout.lidars[l]));
            components.push_back(lidars_[l].component);
        }
        const NcoreScans scans(log_, std::move(components), scans_, std::move(models));
        read::read_scans(log_, layout, scans, options_);
        if (!options_.poses_file.empty()) return;
        const std::string note = read::correct_rays(log_, [&](double time_s) -> std::optional<Pose> {
            if (!PoseGraph::is_known(*vehicle_path_, time_s)) return std::nullopt;
            Pose pose = PoseGraph::pose_at(*vehicle_path_, time_s);
            pose.translation -= log_.world_offset_m;
            return pose;
        });
        if (!note.empty()) log_.notes.push_back(note);
    }
};

}  // namespace
}  // namespace ncore

Log load_ncore(const std::filesystem::path& path, const DatasetOptions& options) {
    if (!does_path_exist(path)) fail("{}: no such file or folder", path.string());
    return ncore::NcoreLoader(path, options).load();
}

}  // namespace relidar
