// SPDX-License-Identifier: Apache-2.0
// nuScenes. A file of LIDAR_TOP holds the columns of one clockwise turn of an HDL-32E in order of time, brought to the end of the turn.
#include "dataset/nuscenes/nuscenes.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include <fmt/format.h>

#include <relidar/error.hpp>
#include <relidar/reader.hpp>
#include "core/files.hpp"
#include "core/progress_blocks.hpp"
#include "dataset/broken_scans.hpp"
#include "dataset/kitti/kitti_files.hpp"
#include "dataset/nuscenes/nuscenes_tables.hpp"
#include "dataset/told_firings.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using namespace nuscenes;

constexpr std::size_t kBeams = 32, kPointBytes = 20;
constexpr double kPeriod_s = 0.05;
constexpr double kNoReturn_m = 1.0;  // nearer than this nothing was measured: such points were at the origin before they were compensated
constexpr double kFarthestOfSweep_m = 1e4;
constexpr std::size_t kMostColumnsOfSweep = 8192;

/// HDL-32E, nominal: +10.67 to -30.67 degrees.
SpinningSensor hdl32e() {
    SpinningSensor sensor;
    sensor.name = "HDL-32E";
    sensor.period_s = kPeriod_s;
    for (std::size_t row = 0; row < kBeams; ++row)
        sensor.beams.push_back({.elevation_rad = (32.0 - 4.0 * double(row)) / 3.0 * kPi / 180.0});
    return sensor;
}

/// Scenes of all tables of a dataset, each with its tables.
struct SceneName {
    std::string name;
    fs::path tables;
};
std::vector<SceneName> list_scenes_of(const fs::path& folder) {
    std::vector<SceneName> scenes;
    for (const fs::path& tables : list_folder(folder)) {
        if (!tables.filename().string().starts_with("v1.0-") || !path_exists(tables / "scene.json")) continue;
        for (const std::string& name : list_scenes(tables)) scenes.push_back({name, tables});
    }
    if (scenes.empty()) throw DataError(fmt::format("{}: no scene, expected some in v1.0-*/scene.json", folder.string()));
    return scenes;
}

SceneName choose_scene(const std::vector<SceneName>& scenes, const std::string& wanted) {
    if (wanted.empty()) return scenes[0];
    const std::optional<int> number = file_number(wanted);
    const std::string named = number ? fmt::format("scene-{:04}", *number) : wanted;
    std::string names;
    for (const SceneName& scene : scenes) {
        if (scene.name == named) return scene;
        if (names.size() < 400) names += (names.empty() ? "" : ", ") + excerpt(scene.name);
    }
    throw UsageError(fmt::format("dataset.sequence '{}': no such scene, expected one of {}: {}", excerpt(wanted), scenes.size(), names));
}

/// Points of a file on their rings and columns, in the LiDAR's frame at the moment of each.
struct ReadSweep {
    ScanPoints points;
    Sweep sweep;
};

/// Leaves out what was not measured: points that were at the LiDAR before the dataset moved them.
/// @param points  in the LiDAR's frame at the moment of each @param numbers  of their columns
void leave_out_unmeasured(ScanPoints& points, std::vector<int>& numbers) {
    std::size_t n = 0;
    for (std::size_t i = 0; i < points.size(); ++i) {
        if (double(glm::length(points.point_m[i])) < kNoReturn_m) continue;
        points.point_m[n] = points.point_m[i];
        points.intensity[n] = points.intensity[i];
        points.ring[n] = points.ring[i];
        points.time_offset_s[n] = points.time_offset_s[i];
        numbers[n++] = numbers[i];
    }
    points.point_m.resize(n), points.intensity.resize(n), points.ring.resize(n), points.time_offset_s.resize(n), numbers.resize(n);
}

ReadSweep read_sweep(const fs::path& file, const SpinningSensor& sensor, const PoseTrack& world_from_sensor, double time_s) {
    const std::string bytes = read_file(file);
    if (bytes.empty() || bytes.size() % (kBeams * kPointBytes) != 0 || bytes.size() / (kBeams * kPointBytes) > kMostColumnsOfSweep)
        throw DataError(fmt::format("{}: {} bytes, expected columns of {} points of {} bytes, 1 to {} of them", file.string(), bytes.size(),
                                    kBeams, kPointBytes, kMostColumnsOfSweep));
    const std::size_t n = bytes.size() / kPointBytes, columns = n / kBeams;
    ReadSweep read;
    std::vector<int> numbers;
    for (std::size_t i = 0; i < n; ++i) {
        float v[5];  // x right, y forward, z up, intensity, ring
        std::memcpy(v, bytes.data() + i * kPointBytes, kPointBytes);
        const double range_m = std::hypot(double(v[0]), double(v[1]), double(v[2]));
        if (!(range_m < kFarthestOfSweep_m) || !std::isfinite(v[3]))
            throw DataError(fmt::format("{}: point {} at ({}, {}, {}), intensity {}, expected metres within {}", file.string(), i, v[0],
                                        v[1], v[2], v[3], kFarthestOfSweep_m));
        if (!(v[4] >= 0.0f && v[4] < float(kBeams)) || v[4] != std::floor(v[4]))
            throw DataError(fmt::format("{}: point {} of ring {}, expected 0 to {}", file.string(), i, v[4], kBeams - 1));
        if (range_m == 0.0) continue;
        const std::size_t column = i / kBeams;
        read.points.point_m.emplace_back(v[1], -v[0], v[2]);
        read.points.intensity.push_back(v[3] / 255.0f);
        read.points.ring.push_back(std::uint16_t(kBeams - 1 - std::size_t(v[4])));
        read.points.time_offset_s.push_back(float(-kPeriod_s * (1.0 - double(column) / double(columns))));
        numbers.push_back(int(column));
    }
    undo_compensation(read.points, world_from_sensor, time_s);
    leave_out_unmeasured(read.points, numbers);
    if (read.points.size() == 0) throw DataError(fmt::format("{}: no point beyond {} m, expected some", file.string(), kNoReturn_m));
    read.sweep = arrange_firings(read.points, numbers, sensor, -2.0 * kPi / double(columns));
    return read;
}

/// Boxes at the times of frames, between the keyframes at which they were labelled.
std::vector<BoxTrack> boxes_at(const std::vector<BoxLabel>& labels, const std::vector<double>& times_s) {
    std::vector<BoxTrack> boxes;
    for (const BoxTrack& labelled : tracks_of(labels)) {
        BoxTrack box{labelled.id, labelled.category, labelled.size_m, {}};
        for (const double time_s : times_s) {
            if (!labelled.world_from_box.covers(time_s)) continue;
            box.world_from_box.time_s.push_back(time_s);
            box.world_from_box.pose.push_back(labelled.world_from_box.at(time_s));
        }
        if (!box.world_from_box.pose.empty()) boxes.push_back(std::move(box));
    }
    return boxes;
}

/// Whether no sweep between keyframes has its file, as where samples/ was unpacked without sweeps/.
bool has_keyframes_alone(const SceneTables& scene, const fs::path& folder) {
    std::size_t n_between = 0;
    for (const SweepRecord& sweep : scene.sweeps) {
        if (sweep.is_keyframe) continue;
        if (path_exists(folder / sweep.file)) return false;
        ++n_between;
    }
    return n_between > 0;
}

/// The frames of a range with the dataset's poses.
struct Frames {
    std::vector<int> numbers;
    std::vector<fs::path> files;
    PoseTrack own;
};
Frames frames_in(const SceneTables& scene, const fs::path& folder, const FrameRange& range, bool keyframes_alone) {
    const int n = int(scene.sweeps.size()), end = range.end < 0 ? n : std::min(range.end, n);
    Frames frames;
    for (int i = range.begin; i < end; ++i) {
        const SweepRecord& sweep = scene.sweeps[std::size_t(i)];
        if (keyframes_alone && !sweep.is_keyframe) continue;
        frames.numbers.push_back(i);
        frames.files.push_back(folder / sweep.file);
        frames.own.time_s.push_back(double(sweep.time_us - scene.sweeps[0].time_us) * 1e-6);
        frames.own.pose.push_back(sweep.world_from_ego);
    }
    if (frames.numbers.empty())
        throw UsageError(fmt::format("frames {}:{}: no {} of {}, expected numbers in [0, {}]", range.begin, range.end,
                                     keyframes_alone ? "keyframe" : "sweep", scene.name, n - 1));
    return frames;
}

void read_sweeps(Sequence& sequence, const Frames& frames, const DatasetOptions& options) {
    BrokenScans broken(options.skip_broken);
    SpinningSensor& sensor = sequence.lidars[0].sensor;
    const PoseTrack way = moved_track(frames.own, sequence.lidars[0].vehicle_from_sensor);
    std::vector<ReadSweep> sweeps(frames.files.size());
    for_each_told(sweeps.size(), options.progress, "reading sweeps", [&](std::size_t at) {
        broken.attempt(at, [&] { sweeps[at] = read_sweep(frames.files[at], sensor, way, way.time_s[at]); });
    });
    for (const ReadSweep& read : sweeps) sensor.columns = std::max(sensor.columns, int(read.sweep.firings.size()));
    sensor.first_azimuth_rad = kPi - kPi / sensor.columns;
    for_each_told(sweeps.size(), options.progress, "putting points on the rays that were fired", [&](std::size_t at) {
        if (!broken.has(at)) sequence.frames[at].scan = spinning_scan(sweeps[at].points, sensor, sweeps[at].sweep);
        sweeps[at] = {};
    });
    broken.leave_out(sequence);
}

}  // namespace

Sequence load_nuscenes(const fs::path& folder, const DatasetOptions& options) {
    check_folder(folder, "nuScenes (v1.0-*/, samples/, sweeps/)");
    const SceneName chosen = choose_scene(list_scenes_of(folder), options.sequence);
    const SceneTables scene = read_scene(chosen.tables, chosen.name);
    const bool keyframes_alone = has_keyframes_alone(scene, folder);
    const Frames frames = frames_in(scene, folder, options.frames, keyframes_alone);
    Sequence sequence;
    sequence.name = "nuScenes " + chosen.name;
    sequence.source = folder.string();
    sequence.conventions =
        "vehicle x forward, y left, z up; LiDAR x forward, y left, z up (nuScenes: x right, y forward); metres; time = end of the turn, "
        "seconds "
        "after the scene's first; world: the map's frame; motion compensation undone; boxes interpolated between keyframes";
    // nuScenes' LiDAR frame is ours turned a quarter to the left
    const Pose theirs_from_ours{glm::angleAxis(kPi / 2.0, glm::dvec3(0, 0, 1)), glm::dvec3(0.0)};
    sequence.lidars[0] = {"", hdl32e(), scene.ego_from_lidar * theirs_from_ours};
    sequence.lidars[0].sensor.max_range_m = options.max_range_m;
    if (keyframes_alone) sequence.notes.push_back("no file of sweeps/ is there: the scene is read with its keyframes alone, 2 a second");
    if (scene.labels.empty()) sequence.notes.push_back("no annotations of this scene: nothing in it is labelled");
    for (std::size_t i = 0; i < frames.numbers.size(); ++i)
        add_frame(sequence, frames.numbers[i], frames.own.time_s[i], frames.own.pose[i]);
    sequence.boxes = boxes_at(scene.labels, frames.own.time_s);
    kitti::take_given_poses(sequence, options.poses_file);
    recentre(sequence);
    read_sweeps(sequence, frames, options);
    return sequence;
}

}  // namespace relidar
