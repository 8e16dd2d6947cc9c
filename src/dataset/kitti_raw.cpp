// SPDX-License-Identifier: Apache-2.0
// KITTI raw: reads a drive's files, recovers the sensor from its own scans (rings, cones, firing lattice), and puts every
// turn on the rays that were fired. The scans are not motion-compensated: each ray keeps its own firing time.
#include "dataset/kitti_raw.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/error.hpp>
#include "core/files.hpp"
#include "core/parallel.hpp"
#include "core/progress_blocks.hpp"
#include "dataset/kitti_files.hpp"
#include "dataset/kitti_grid.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using namespace kitti;

// The fits are far better than the file's millimetres with a few turns; more would only cost time.
constexpr std::size_t kFitScans = 6, kLatticeScans = 3;

std::vector<const RawScan*> spread(const std::vector<RawScan>& scans, std::size_t n) {
    std::vector<const RawScan*> some;
    n = std::min(n, scans.size());
    for (std::size_t i = 0; i < n; ++i) some.push_back(&scans[i * scans.size() / n]);
    return some;
}

std::vector<RawScan> read_scans(const fs::path& drive, const std::vector<int>& frames, const Progress& progress) {
    std::vector<RawScan> scans(frames.size());
    for_each_told(frames.size(), progress, "reading scans", [&](std::size_t at) {
        scans[at] = split_rings(read_scan(drive / "velodyne_points/data" / fmt::format("{:010d}.bin", frames[at])));
    });
    return scans;
}

PoseTrack read_poses(const fs::path& drive, const std::vector<int>& frames, const fs::path& poses_file) {
    PoseTrack track{read_times(drive / "velodyne_points/timestamps.txt", frames), std::vector<Pose>(frames.size())};
    if (poses_file != kNoPoses) track.pose = poses_file.empty() ? read_oxts_poses(drive, frames) : read_pose_file(poses_file, frames);
    return track;
}

std::string describe_poses(const fs::path& poses_file) {
    if (poses_file == kNoPoses) return "no poses: the sensor is at the origin in every frame";
    return "poses from " + (poses_file.empty() ? "OXTS (Mercator)" : poses_file.string());
}

/// Before rays are made: as many as the azimuths say, and no more than the points can be returns of.
void check_rays(const std::vector<RawScan>& raw, const FiringLattice& lattice, const std::string& where) {
    constexpr int kMostFirings = 8192;           // an HDL-64E has up to 4170 a turn
    constexpr std::size_t kMostRaysAPoint = 200;   // whole turns have 1.1
    if (lattice.n_ticks > kMostFirings)
        throw DataError(fmt::format("{}: azimuths of neighbouring points differ by 1/{} of a turn, expected at most {} firings of an HDL-64E", where, lattice.n_ticks, kMostFirings));
    std::size_t n_points = 0;
    for (const RawScan& scan : raw) n_points += scan.points.size();
    const std::size_t n_rays = raw.size() * kRings * std::size_t(lattice.every_tick ? lattice.n_ticks : 1);
    if (n_rays > kMostRaysAPoint * n_points) throw DataError(fmt::format("{}: {} points in {} turns of {} rays, expected whole turns", where, n_points, raw.size(), n_rays / raw.size()));
}

/// Makes the scans of all frames from their points; sets the sensor's beams and columns.
void grid_scans(std::vector<RawScan>& raw, Sequence& sequence, const fs::path& drive, double max_range_m, const Progress& progress) {
    Hdl64 hdl64;
    const Cones cones = fit_cones(spread(raw, kFitScans), (drive / "velodyne_points/data").string());
    run_parallel(static_cast<int>(raw.size()), [&](int i) { correct_rings(raw[static_cast<std::size_t>(i)], cones); });
    hdl64.lattice = fit_lattice(spread(raw, kLatticeScans));
    check_rays(raw, hdl64.lattice, (drive / "velodyne_points/data").string());

    std::vector<std::vector<int>> firings(raw.size());
    for_each_told(raw.size(), progress, "finding the firings of each turn", [&](std::size_t at) {
        firings[at] = find_firings(raw[at], hdl64.lattice);
        if (firings[at].empty()) {
            throw DataError(fmt::format("{}/{:010d}.bin: {} points without a firing in common, expected a turn of an HDL-64E",
                                        (drive / "velodyne_points/data").string(), sequence.frames[at].index, raw[at].points.size()));
        }
    });
    SpinningSensor& sensor = sequence.sensor;
    sensor.beams = make_beams(cones, hdl64.lattice);
    for (const auto& turn : firings) sensor.columns = std::max(sensor.columns, static_cast<int>(turn.size()));
    sensor.first_azimuth_rad = kPi - kPi / sensor.columns;
    hdl64.sensor = sensor;
    for_each_told(raw.size(), progress, "putting points on the rays that were fired", [&](std::size_t at) {
        sequence.frames[at].scan = make_scan(raw[at], firings[at], hdl64, max_range_m).scan;
        raw[at] = {};
    });
}

/// What the drive lacks. Scans may be missing in the middle of it (drive 0009 lacks four), labels and poses altogether.
std::vector<std::string> take_notes(const fs::path& drive, const std::vector<int>& frames, const DatasetOptions& options) {
    std::vector<std::string> notes;
    const std::string gaps = describe_gaps(frames);
    if (!gaps.empty() && !options.allow_missing_scans)
        throw DataError(fmt::format("{}/velodyne_points/data: {}, expected all; dataset.allow_missing_scans=true leaves them out", drive.string(), gaps));
    if (!gaps.empty()) notes.push_back(gaps + ": left out");
    if (!path_exists(drive / "tracklet_labels.xml")) notes.push_back("no tracklet_labels.xml: nothing in this drive is labelled");
    if (options.poses_file == kNoPoses) notes.push_back("no poses are read (dataset.poses=none): they have to be found from the scans");
    return notes;
}

/// Moves the world's origin to the sensor position in the middle frame: float precision downstream.
void recentre(Sequence& sequence) {
    PoseTrack& track = sequence.world_from_sensor;
    sequence.world_offset_m = track.pose[track.pose.size() / 2].translation;
    for (Pose& pose : track.pose) pose.translation -= sequence.world_offset_m;
}

}  // namespace

Sequence load_kitti_raw(const fs::path& folder, const DatasetOptions& options) {
    check_folder(folder, "a KITTI raw drive (velodyne_points/)");
    if (!path_exists(folder / "velodyne_points")) {
        const std::string stranger = describe_stranger(folder, "velodyne_points");
        if (!stranger.empty()) throw DataError(fmt::format("{}: no drive, but {}", folder.string(), stranger));
    }
    const fs::path drive = fs::canonical(folder);
    const std::vector<int> frames = list_scans(drive, options.frames.begin, options.frames.end);

    Sequence sequence;
    sequence.name = drive.filename().string();
    sequence.source = folder.string();
    sequence.conventions = fmt::format(
        "sensor x forward, y left, z up; metres; time = head faces forward, seconds after the log's first "
        "turn; {}; scans not motion-compensated; boxes in the front camera's view only",
        describe_poses(options.poses_file));
    sequence.notes = take_notes(drive, frames, options);
    sequence.sensor.name = "HDL-64E fitted to " + sequence.name;
    sequence.sensor.period_s = read_period(drive);
    sequence.sensor.max_range_m = options.max_range_m;
    sequence.world_from_sensor = read_poses(drive, frames, options.poses_file);
    recentre(sequence);
    sequence.boxes = read_tracklets(drive / "tracklet_labels.xml", frames, sequence.world_from_sensor);
    for (std::size_t i = 0; i < frames.size(); ++i) {
        sequence.frames.push_back({.index = frames[i], .time_s = sequence.world_from_sensor.time_s[i], .scan = {}});
    }
    std::vector<RawScan> raw = read_scans(drive, frames, options.progress);
    grid_scans(raw, sequence, drive, options.max_range_m, options.progress);
    return sequence;
}

}  // namespace relidar
