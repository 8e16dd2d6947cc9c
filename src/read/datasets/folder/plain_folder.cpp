// SPDX-License-Identifier: Apache-2.0
#include "read/readers.hpp"

#include <algorithm>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "read/files/scan_npz.hpp"
#include "read/scans/folder_head.hpp"
#include "read/scans/folder_points.hpp"
#include "read/scans/pose_files.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using read::LogFrame;

/// Returns the frames in the requested range whose scan file exists.
/// @throws DataError if a scan file is missing and missing scans are not allowed
/// @throws UsageError if the range contains no scan file
std::vector<LogFrame> select_frames(const read::FolderHead& header, const DatasetOptions& options,
                                    Notes& notes) {
    std::vector<LogFrame> frames;
    std::size_t n_missing = 0;
    for (const LogFrame& frame : header.frames) {
        if (!options.frames.contains(frame.number)) continue;
        if (does_path_exist(frame.scan)) {
            frames.push_back(frame);
            continue;
        }
        if (!options.allow_missing_scans)
            fail("{}: no such file, expected the scan of frame {}", frame.scan.string(), frame.number);
        ++n_missing;
    }
    if (frames.empty())
        fail<UsageError>(
            "frames {}:{} select no existing scan of {}; {} scans are missing", options.frames.begin,
            options.frames.end < 0 ? "" : std::to_string(options.frames.end), header.name, n_missing);
    if (n_missing > 0)
        notes.push_back(fmt::format("{} scans of the list in sequence.json are missing", n_missing));
    return frames;
}

/// Returns the points of a scan that is stored as a range image, in the sensor frame.
std::vector<glm::vec3> read_image_points(const read::FolderHead& header, const read::PointFileUnits& units,
                                         const LogFrame& frame) {
    const read::HeaderLidar& lidar = header.lidars[std::size_t(frame.lidar)];
    const Scan scan = read::read_scan_image(frame.scan, {.units = units,
                                                         .motion_compensated = header.motion_compensated,
                                                         .lowest_first = lidar.lowest_first,
                                                         .lidar = lidar.lidar,
                                                         .time_s = frame.time_s});
    std::vector<glm::vec3> points;
    for (std::size_t i = 0; i < scan.range_m.size(); ++i)
        if (scan.range_m[i] > 0.0f) points.push_back(scan.return_point(i));
    return points;
}

/// Returns the points of a scan in the vehicle frame.
std::vector<glm::vec3> read_vehicle_points(const read::FolderHead& header, const LogFrame& frame) {
    read::PointFileUnits units = header.units;
    units.intensity_max = 1.0;  // any scale works, because the intensities are ignored here
    units.ignore_times = true;
    std::vector<glm::vec3> points;
    if (read::is_image_file(frame.scan)) {
        points = read_image_points(header, units, frame);
    } else {
        const read::PointTable table = read::read_point_file(frame.scan, units.columns);
        points = read::convert_table(table, units, frame.time_s, frame.scan.string()).position_m;
    }
    const Pose& vehicle_from_sensor = header.lidars[std::size_t(frame.lidar)].lidar.vehicle_from_sensor;
    for (glm::vec3& p : points) p = glm::vec3(vehicle_from_sensor * glm::dvec3(p));
    return points;
}

/// Reads a few pairs of consecutive scans of the first LiDAR, evenly spread over the log.
/// With correct poses, the scans of a pair overlap.
read::ScanPairs read_scan_pairs(const read::FolderHead& header, const std::vector<LogFrame>& frames) {
    constexpr std::size_t kMaxPairs = 4;  // enough for a decision, and fast to read
    std::vector<const LogFrame*> scans;   // of the first LiDAR
    for (const LogFrame& frame : frames)
        if (frame.lidar == 0) scans.push_back(&frame);
    read::ScanPairs pairs;
    if (scans.empty()) return pairs;
    const auto read_pair = [&](std::size_t i) {
        const LogFrame &first = *scans[i], &second = *scans[i + 1];
        pairs.add_scan_pair(first.time_s, read_vehicle_points(header, first), second.time_s,
                            read_vehicle_points(header, second));
    };
    read::read_samples(scans.size() - 1, read_pair, kMaxPairs);
    return pairs;
}

/// Returns the vehicle pose of each frame from poses.txt. If this file is missing or
/// damaged and the user selected other poses (dataset.poses), returns identity poses,
/// which the other poses replace later.
std::vector<Pose> read_vehicle_poses(const fs::path& folder, const read::FolderHead& header,
                                     const std::vector<LogFrame>& frames, const DatasetOptions& options,
                                     Log& log) {
    const fs::path file = folder / read::kPosesFile;
    const bool are_replaced = !options.poses_file.empty();
    const auto read_pairs = [&] { return read_scan_pairs(header, frames); };
    try {
        // Settings and notes are those of the poses that replace these.
        Log unused;
        const auto poses =
            read::load_poses(file, frames, read_pairs, are_replaced ? Conventions{} : options.conventions,
                             are_replaced ? unused : log);
        if (poses) return *poses;
    } catch (const DataError& error) {
        if (!are_replaced) throw;
        // Boxes in world coordinates were placed with the poses of this file.
        if (does_path_exist(folder / read::kBoxesFile))
            log.notes.push_back(
                fmt::format("{}; boxes in world coordinates may be at wrong places", error.what()));
    }
    if (are_replaced) return std::vector<Pose>(frames.size());
    fail(
        "{}: no such file; expected poses of the vehicle; use dataset.poses=FILE to name another file, or "
        "dataset.poses=none to estimate the poses from the scans",
        file.string());
}

}  // namespace

Log load_folder(const fs::path& log_folder, const DatasetOptions& options) {
    require_folder(log_folder, "a folder with sequence.json");
    const fs::path folder = fs::canonical(log_folder);
    const read::FolderHead head = read::read_header(folder, options.max_range_m);
    Log log;
    log.name = head.name;
    log.source = log_folder.string();
    log.conventions = head.conventions;
    log.start_unix_ns = head.start_unix_ns;
    log.notes = head.notes;
    log.labelled_azimuth = head.labelled_azimuth;
    log.lidars.clear();
    for (const read::HeaderLidar& lidar : head.lidars) log.lidars.push_back(lidar.lidar);
    const std::vector<LogFrame> frames = select_frames(head, options, log.notes);
    const std::vector<Pose> poses = read_vehicle_poses(folder, head, frames, options, log);
    std::vector<fs::path> files;
    for (std::size_t i = 0; i < frames.size(); ++i) {
        add_frame(log, frames[i].number, frames[i].time_s, poses[i], frames[i].lidar);
        files.push_back(frames[i].scan);
    }
    log.boxes = read::read_box_tracks(folder / read::kBoxesFile, frames, head.frames);
    read::replace_poses(log, options, [&] { return read_scan_pairs(head, frames); });
    if (options.poses_file.empty()) log.georeference = head.georeference;
    // A saved log gets the same origin as before, unless its poses are replaced.
    if (head.world_offset_m && options.poses_file.empty()) centre_log(log, *head.world_offset_m);
    else centre_log(log);
    const read::ScanLayout layout{.lidars = {head.lidars.begin(), head.lidars.end()},
                                  .motion_compensated = head.motion_compensated,
                                  .declared_by = read::kHeadFile,
                                  .is_deskew_declared = head.motion_compensated,
                                  .is_described = true};
    read::read_scan_files(log, layout, head.units, files, options);
    return log;
}

}  // namespace relidar
