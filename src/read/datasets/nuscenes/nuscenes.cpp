// SPDX-License-Identifier: Apache-2.0
// Reads nuScenes and other datasets with the same tables. These datasets store points in
// different formats. The extension of the point files shows the format.
#include "read/readers.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/error.hpp>
#include <relidar/log/log_time.hpp>
#include <relidar/read/clouds.hpp>
#include "base/fail.hpp"
#include "base/files.hpp"
#include "log/frames/match_sweeps.hpp"
#include "read/datasets/nuscenes/hdl32e_sweeps.hpp"
#include "read/datasets/nuscenes/nuscenes_tables.hpp"
#include "read/scans/folder_head.hpp"
#include "read/scans/pose_files.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using namespace nuscenes;

// Sweeps of several LiDARs form a frame if their times differ by at most this share of a
// sweep period.
constexpr double kMaxSweepGap = 0.6;
// Boxes exist this share of a sweep period beyond their labels, whose times differ
// slightly.
constexpr double kBeyondLabels = 0.5;
constexpr double kMostIntensity = 255.0;
// LiDARs rotate ten times per second, although the dataset has only five sweeps per
// second.
constexpr double kLyftRevolution_s = 0.1;
// Without point times, all LiDARs of a frame use the time of the first. Larger
// differences are noted.
constexpr double kStampsApart_s = 1e-3;

/// A format with the tables of nuScenes. Except for T4, the extension of LiDAR files
/// identifies it.
struct NuscenesVariant {
    const char* ending;
    const char* dataset;
    const char* conventions;  ///< conventions of the dataset, except units and vehicle axes
    /// True if points were moved to the end of the revolution. A file then contains a
    /// revolution of an HDL-32E, column by column.
    bool is_compensated;
    bool has_times;          ///< true: points have times
    bool has_rings = false;  ///< true: the fifth column is the ring, and 0 is the lowest
};
constexpr NuscenesVariant kVariants[] = {
    {".pcd.bin", "nuScenes",
     "LiDAR frame: x forward, y left, z up (in nuScenes' files, x points right and y forward). The time of a "
     "frame is the end of its sweep. The world frame is that of the map. The motion compensation of the "
     "points is removed.",
     true, false},
    {".pcd", "TruckScenes",
     "Each LiDAR has its own coordinate system. Points are not motion-compensated. The time of a frame is "
     "the stamp of the first LiDAR's sweep. World coordinates: UTM 32U.",
     false, true},
    {".bin", "Lyft Level 5",
     "Each LiDAR has its own coordinate system. Points are as in the files. The time of a frame is the stamp "
     "of the first LiDAR's sweep. World coordinates are those of the map.",
     false, false},
};

/// T4: points are in the vehicle frame. A file may contain the merged points of several
/// LiDARs.
constexpr NuscenesVariant kT4Variant = {
    ".pcd.bin", "T4",
    "Points are motion-compensated and in the frame of the vehicle. The time of a frame is the stamp of its "
    "sweep. The world frame is that of the map.",
    false, false};
/// Tables of nuScenes with another LiDAR than an HDL-32E. `relidar render --layout`
/// writes them.
constexpr NuscenesVariant kOtherLidarVariant = {
    ".pcd.bin",
    "nuScenes layout",
    "Each LiDAR has its own coordinate system. Points are motion-compensated. The time of a frame is the "
    "stamp of the first LiDAR's sweep, for all points. The world frame is that of the map.",
    false,
    false,
    true};
constexpr const char* kTablesOfT4 = "annotation";  // name of the folder that contains the tables

struct SceneLocation {
    std::string name;
    fs::path tables;
};
/// Lists the scenes of all table folders. A table folder is a subfolder that contains
/// scene.json, for example v1.0-mini.
std::vector<SceneLocation> list_dataset_scenes(const fs::path& dataset_folder) {
    std::vector<SceneLocation> scenes;
    for (const fs::path& tables : list_folder(dataset_folder)) {
        if (!does_path_exist(tables / "scene.json")) continue;
        for (const std::string& name : list_scenes(tables)) scenes.push_back({name, tables});
    }
    if (scenes.empty())
        fail("{} contains no scene, expected at least one in */scene.json", dataset_folder.string());
    return scenes;
}

/// Returns the scene that the user requested: by its name, by its nuScenes number, or by
/// the first characters of its name. No other scene may begin with these characters.
SceneLocation choose_scene(const std::vector<SceneLocation>& scenes, const std::string& requested_name) {
    if (requested_name.empty()) return scenes[0];
    const std::optional<int> number = parse_stem(requested_name);
    const std::string full_name = number ? fmt::format("scene-{:04}", *number) : requested_name;
    constexpr std::size_t kMaxKnownText = 400;  // a dataset has up to 850 scenes
    std::string known_names;                    // for the error message
    std::vector<const SceneLocation*> matches;
    for (const SceneLocation& scene : scenes) {
        if (scene.name == full_name) return scene;
        if (scene.name.starts_with(requested_name) || scene.name.starts_with("scene-" + requested_name))
            matches.push_back(&scene);
        if (known_names.size() < kMaxKnownText)
            known_names += (known_names.empty() ? "" : ", ") + quote(scene.name);
    }
    if (matches.size() == 1) return *matches[0];
    fail<UsageError>("dataset.sequence '{}' {}, expected the name or the number of one of the {} scenes: {}",
                     quote(requested_name),
                     matches.empty()
                         ? "is not a scene of this dataset"
                         : fmt::format("is the beginning of the names of {} scenes", matches.size()),
                     scenes.size(), known_names);
}

/// Returns the boxes at the times of all frames. Interpolates, because only keyframes
/// have labels. Also sets boxes up to max_extrapolation_s before the first and after the
/// last label of an object.
std::vector<BoxTrack> tracks_at_frames(const std::vector<BoxLabel>& labels,
                                       const std::vector<double>& frame_times_s, double max_extrapolation_s) {
    std::vector<BoxTrack> boxes;
    for (const BoxTrack& labelled : build_tracks(labels)) {
        BoxTrack box{labelled.id, labelled.category, labelled.size_m, {}};
        const PoseTrack& track = labelled.world_from_box;
        for (const double time_s : frame_times_s)
            if (time_s >= track.time_s.front() - max_extrapolation_s &&
                time_s <= track.time_s.back() + max_extrapolation_s)
                box.world_from_box.append(time_s, track.pose_at(time_s));
        if (!box.world_from_box.pose.empty()) boxes.push_back(std::move(box));
    }
    return boxes;
}

struct FrameSweepRecord {
    int number = 0;         ///< number of the frame: index of the simultaneous sweep of the first LiDAR
    std::size_t lidar = 0;  ///< index in SceneTables::lidars
    const SweepRecord* record = nullptr;
};

/// Returns the place of a map of nuScenes on the earth, or nothing for other maps. Map
/// coordinates are metres east and north of a corner of the map, on a sphere (azimuthal
/// equidistant projection, aeqd).
std::optional<Georeference> find_map_place(const std::string& location) {
    struct MapCorner {
        const char* name;
        double latitude_deg, longitude_deg;
    };
    static constexpr MapCorner kMaps[] = {
        {"boston-seaport", 42.336849169438615, -71.05785369873047},
        {"singapore-onenorth", 1.2882100868743724, 103.78475189208984},
        {"singapore-hollandvillage", 1.2993652317780957, 103.78217697143555},
        {"singapore-queenstown", 1.2782562240223188, 103.76741409301758}};
    const auto* map = std::ranges::find(kMaps, location, &MapCorner::name);
    if (map == std::end(kMaps)) return {};
    return Georeference{.position = {map->latitude_deg, map->longitude_deg},
                        .point_m = {},
                        .crs = fmt::format("+proj=aeqd +R=6378137 +lat_0={} +lon_0={}", map->latitude_deg,
                                           map->longitude_deg)};
}

class NuscenesLogLoader {
public:
    /// Reads the tables of the requested scene. The sweeps of its first LiDAR define
    /// the times of all frames.
    NuscenesLogLoader(const fs::path& folder, const DatasetOptions& options)
        : folder_(folder),
          options_(options),
          chosen_(choose_scene(list_dataset_scenes(folder), options.sequence)),
          scene_(read_scene(chosen_.tables, chosen_.name)),
          split_(lyft_prefix(chosen_.tables)),
          format_(chosen_.tables.filename() == kTablesOfT4 ? kT4Variant
                                                           : find_variant(scene_.lidars[0].sweeps[0])) {
        for (const SweepRecord& sweep : scene_.lidars[0].sweeps)
            main_s_.push_back(scene_.seconds_at(sweep.time_us));
        step_s_ = median_interval_s(main_s_);
    }

    Log load_scene() {
        log_.name = fmt::format("{} {}", format_.dataset, scene_.name);
        log_.source = folder_.string();
        log_.conventions = fmt::format(
            "Vehicle frame: x forward, y left, z up, in metres. Times are seconds after the first sweep of "
            "the scene. Boxes are interpolated between keyframes. {}",
            format_.conventions);
        set_log_start(log_, 1000 * scene_.lidars[0].sweeps[0].time_us, "on the clock of the dataset");
        select_lidars();
        log_.cameras = scene_.cameras;
        for (Camera& camera : log_.cameras)
            camera.rig_from_camera =
                inverse(log_.lidars.front().vehicle_from_sensor) * camera.rig_from_camera;
        select_sweeps();
        for (const FrameSweepRecord& frame : frames_) {
            const std::size_t k = std::size_t(frame.number);
            const auto lidar = std::ranges::find(lidars_, frame.lidar) - lidars_.begin();
            add_frame(log_, frame.number, main_s_[k], scene_.world_from_ego[k], int(lidar));
        }
        // Keeps the poses of the dataset, because its motion compensation used them and
        // not the poses of the user.
        const PoseTrack vehicle_track = log_.world_from_vehicle;
        if (scene_.labels.empty()) add_note("this scene has no annotations, so it has no labels");
        log_.boxes = tracks_at_frames(scene_.labels, vehicle_track.time_s, kBeyondLabels * step_s_);
        read::replace_poses(log_, options_);
        centre_log(log_);
        if (options_.poses_file.empty()) log_.georeference = find_map_place(scene_.location);
        if (format_.is_compensated)
            read_hdl32e_sweeps(log_, list_frame_files(), scene_.classes, vehicle_track, options_);
        else read_point_scans();
        return std::move(log_);
    }

private:
    const fs::path& folder_;
    const DatasetOptions& options_;
    const SceneLocation chosen_;
    const SceneTables scene_;
    /// "train_" if tables are in train_data and points in train_lidar (Lyft)
    const std::string split_;
    const NuscenesVariant& format_;
    std::vector<double> main_s_;       ///< times in seconds of the sweeps of the first LiDAR
    double step_s_ = 0.0;              ///< time between these sweeps
    std::vector<std::size_t> lidars_;  ///< [log_.lidars] index in scene_.lidars
    std::vector<FrameSweepRecord> frames_;
    Log log_;

    /// Identifies the dataset by the ending of the LiDAR files. Files with nuScenes'
    /// ending may come from another LiDAR, so their points are tested too.
    const NuscenesVariant& find_variant(const SweepRecord& sweep) const {
        const std::string& lidar_file = sweep.file;
        std::vector<std::string> endings;
        for (const NuscenesVariant& format : kVariants) {
            if (lidar_file.ends_with(format.ending))
                return format.is_compensated && !is_hdl32e_file(sweep_file(sweep)) ? kOtherLidarVariant
                                                                                   : format;
            endings.emplace_back(format.ending);
        }
        fail("sample_data.json, key 'filename': found the LiDAR file '{}', expected a name that ends in {}",
             quote(lidar_file), fmt::join(endings, ", "));
    }

    void add_note(std::string text) { log_.notes.push_back(std::move(text)); }
    static std::string lyft_prefix(const fs::path& table_folder) {
        const std::string name = table_folder.filename().string();
        return name.ends_with("_data") ? name.substr(0, name.size() - 4) : "";
    }
    fs::path sweep_file(const SweepRecord& sweep) const {
        const fs::path file = folder_ / sweep.file;
        return split_.empty() || does_path_exist(file) ? file : folder_ / (split_ + sweep.file);
    }

    /// Adds the requested LiDARs to the log, or all LiDARs if none are requested.
    void select_lidars() {
        std::vector<std::string> channels, left_out;
        for (const SceneLidar& lidar : scene_.lidars) channels.push_back(lidar.channel);
        for (const std::string& name : options_.lidars)
            if (std::ranges::find(channels, name) == channels.end())
                fail<UsageError>(
                    "dataset.lidars: the scene {1} has no LiDAR '{0}', expected one or more of: {2}",
                    quote(name), scene_.name, fmt::join(channels, ", "));
        log_.lidars.clear();
        for (std::size_t l = 0; l < channels.size(); ++l) {
            if (!options_.lidars.empty() &&
                std::ranges::find(options_.lidars, channels[l]) == options_.lidars.end()) {
                left_out.push_back(channels[l]);
                continue;
            }
            const Pose& mounted = scene_.lidars[l].ego_from_lidar;
            Lidar lidar;
            lidar.vehicle_from_sensor = mounted;
            lidar.sensor.name = channels[l];
            if (format_.is_compensated) lidar = make_hdl32e(mounted);
            // A LiDAR needs a name only if the log has several or the user selected it.
            if (channels.size() > 1 || !options_.lidars.empty()) lidar.name = channels[l];
            lidar.sensor.max_range_m = options_.max_range_m;
            log_.lidars.push_back(std::move(lidar));
            lidars_.push_back(l);
        }
        if (format_.is_compensated && lidars_.size() > 1)
            fail(
                "{} has {} LiDARs with {} files, but only one LiDAR of this format can be read; select it "
                "with dataset.lidars",
                scene_.name, lidars_.size(), format_.ending);
        if (!left_out.empty())
            add_note(fmt::format("these LiDARs of the log are not read: {}", fmt::join(left_out, ", ")));
    }

    /// Assigns a frame number to each sweep of the selected LiDARs: the number of the
    /// simultaneous sweep of the first LiDAR. Returns the sweeps in the order of frame
    /// numbers.
    std::vector<FrameSweepRecord> number_frames() {
        std::vector<FrameSweepRecord> sweeps;
        for (const std::size_t l : lidars_) {
            const std::vector<SweepRecord>& records = scene_.lidars[l].sweeps;
            std::vector<double> times_s;
            for (const SweepRecord& record : records) times_s.push_back(scene_.seconds_at(record.time_us));
            // [sweeps of the first LiDAR] index of the simultaneous sweep of this LiDAR
            const auto matches = match_sweeps(main_s_, times_s, kMaxSweepGap * step_s_);
            std::size_t n_left = records.size();
            double apart_s = 0.0;
            for (std::size_t k = 0; k < matches.size(); ++k) {
                if (!matches[k]) continue;
                apart_s = std::max(apart_s, std::abs(times_s[*matches[k]] - main_s_[k]));
                sweeps.push_back({int(k), l, &records[*matches[k]]});
                --n_left;
            }
            if (!format_.has_times && apart_s > kStampsApart_s)
                add_note(fmt::format(
                    "{0}: its points have no times, so each of its sweeps gets the time of the nearest sweep "
                    "of {2}; the stamps of two such sweeps differ by up to {1:.3f} s",
                    scene_.lidars[l].channel, apart_s, scene_.lidars[0].channel));
            if (n_left > 0)
                add_note(fmt::format("{}: {} sweeps are skipped, because {} has no sweeps at similar times",
                                     scene_.lidars[l].channel, n_left, scene_.lidars[0].channel));
        }
        std::ranges::stable_sort(sweeps, {}, &FrameSweepRecord::number);
        return sweeps;
    }

    /// Selects the frames in the requested range. If only keyframes have files, selects
    /// only keyframes. This happens if the user has not unpacked the folder sweeps/.
    void select_sweeps() {
        const std::vector<FrameSweepRecord> sweeps = number_frames();
        const auto is_between = [](const FrameSweepRecord& sweep) { return !sweep.record->is_keyframe; };
        const auto is_no_file_between = [&](const FrameSweepRecord& sweep) {
            return !is_between(sweep) || !does_path_exist(sweep_file(*sweep.record));
        };
        const bool keyframes_alone =
            std::ranges::any_of(sweeps, is_between) && std::ranges::all_of(sweeps, is_no_file_between);
        const FrameRange& range = options_.frames;
        for (const FrameSweepRecord& sweep : sweeps)
            if (range.contains(sweep.number) && !(keyframes_alone && is_between(sweep)))
                frames_.push_back(sweep);
        if (frames_.empty()) fail_empty_range(range, scene_.name, 0, int(main_s_.size()) - 1);
        if (keyframes_alone)
            add_note("the files between keyframes are missing, so only the keyframes of the scene are read");
    }

    /// Lists the files of points and of point labels, one pair per frame. Label files
    /// are a separate download, so missing ones only cause a note.
    std::vector<SweepFiles> list_frame_files() {
        std::vector<SweepFiles> files;
        std::size_t n_missing = 0;
        for (const FrameSweepRecord& frame : frames_) {
            const std::string& categories = frame.record->categories_file;
            const bool has_categories = !categories.empty() && does_path_exist(folder_ / categories);
            n_missing += !categories.empty() && !has_categories;
            files.push_back({sweep_file(*frame.record), has_categories ? folder_ / categories : ""});
        }
        if (n_missing > 0)
            add_note(
                fmt::format("labels of points: {} of the files in lidarseg.json are missing", n_missing));
        return files;
    }

    /// Reads the scans of T4, TruckScenes and Lyft datasets. read_hdl32e_sweeps() reads
    /// those of nuScenes itself.
    void read_point_scans() {
        std::vector<fs::path> files;
        for (const FrameSweepRecord& frame : frames_) files.push_back(sweep_file(*frame.record));
        read::PointFileUnits units;
        // The last column is always 1 (Lyft) or -1 (T4).
        if (!format_.has_times)
            units.columns = {"x", "y", "z", "intensity", format_.has_rings ? "ring" : "-"};
        units.intensity_max = kMostIntensity;
        units.time_unit_s = 1e-6;
        units.absolute_times = true;
        units.time_zero = double(scene_.lidars[0].sweeps[0].time_us);
        const read::LidarScanLayout lidar{
            .lowest_first = format_.has_rings,
            .sweep_duration_s = format_.has_times ? step_s_ : kLyftRevolution_s};
        // Compensated points of other LiDARs have the time of the frame.
        const bool is_compensated = format_.has_rings;
        DatasetOptions options = options_;
        if (is_compensated) options.rolling_shutter = false;  // keeps them as they are
        read::read_scan_files(
            log_, {.lidars = std::vector(log_.lidars.size(), lidar), .motion_compensated = is_compensated},
            units, files, options);
        if (!is_compensated) return;
        for (Frame& frame : log_.frames) std::ranges::fill(frame.scan.rays.time_offset_s, 0.0f);
    }
};

}  // namespace

Log load_nuscenes(const fs::path& folder, const DatasetOptions& options) {
    require_folder(folder,
                   "nuScenes, TruckScenes, Lyft Level 5 or T4 (tables in v1.*/, *data/ or annotation/)");
    return NuscenesLogLoader(folder, options).load_scene();
}

}  // namespace relidar
