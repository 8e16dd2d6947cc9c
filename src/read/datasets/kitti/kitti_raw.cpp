// SPDX-License-Identifier: Apache-2.0
// Reads KITTI raw drives. The scans are not motion-compensated, so the reader computes
// the firing time of each ray.
#include "read/readers.hpp"

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/read/clouds.hpp>
#include "base/fail.hpp"
#include "base/files.hpp"
#include "read/datasets/kitti/kitti_sweeps.hpp"
#include "read/kitti/log_files.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using namespace kitti;

PoseTrack read_raw_poses(const fs::path& drive_folder, const std::vector<int>& numbers,
                         const fs::path& user_pose_file, Log& sequence) {
    PoseTrack track{read_frame_times(drive_folder / "velodyne_points/timestamps.txt", numbers, sequence),
                    // These identity poses remain if the user selects no poses.
                    std::vector<Pose>(numbers.size())};
    if (user_pose_file != kNoPoses)
        track.pose = user_pose_file.empty()
                         ? read_oxts_poses(drive_folder, numbers)
                         : read_user_poses(user_pose_file, numbers, track.time_s, sequence.notes);
    return track;
}

/// Returns notes for the user about missing scans, labels and poses. For example, four
/// scans are missing in the middle of drive 0009.
Notes note_missing_data(const fs::path& drive_folder, const std::vector<int>& numbers,
                        const DatasetOptions& options) {
    Notes notes;
    const std::string gaps =
        check_scan_files(drive_folder / "velodyne_points/data", numbers, options.allow_missing_scans);
    if (!gaps.empty()) notes.push_back(gaps);
    if (!does_path_exist(drive_folder / "tracklet_labels.xml"))
        notes.push_back("tracklet_labels.xml is missing, so this drive has no labels");
    if (options.poses_file == kNoPoses) notes.push_back(kNoPosesNote);
    return notes;
}

}  // namespace

Log load_kitti_raw(const fs::path& folder, const DatasetOptions& options) {
    require_folder(folder, "a KITTI raw drive (velodyne_points/)");
    if (!does_path_exist(folder / "velodyne_points")) {
        const std::string stranger = describe_mistake(folder, "velodyne_points");
        if (!stranger.empty()) fail("{} is not a KITTI raw drive: {}", folder.string(), stranger);
    }
    const fs::path drive = fs::canonical(folder);
    if (drive.parent_path().filename() == "data_3d_raw")
        fail("{} is a drive of KITTI-360; use {} with dataset.sequence={}", folder.string(),
             drive.parent_path().parent_path().string(), drive.filename().string());
    const std::vector<int> frames =
        list_scans(drive / "velodyne_points/data", options.frames.begin, options.frames.end);

    Log sequence;
    sequence.name = drive.filename().string();
    sequence.source = folder.string();
    std::string pose_source = "no poses, so the sensor is at the origin in every frame";
    if (options.poses_file != kNoPoses)
        pose_source =
            "poses from " + (options.poses_file.empty() ? "OXTS (Mercator)" : options.poses_file.string());
    sequence.conventions = fmt::format(
        "Sensor frame: x forward, y left, z up, in metres. Times are seconds after the first sweep of the "
        "log. At the time of a frame, the head faces forward. The log has {}. Scans are not "
        "motion-compensated. Boxes are labelled only in the view of the front camera.",
        pose_source);
    sequence.notes = note_missing_data(drive, frames, options);
    sequence.lidars[0].sensor.name = "HDL-64E fitted to " + sequence.name;
    sequence.lidars[0].sensor.period_s = read_sweep_s(drive);
    sequence.lidars[0].sensor.max_range_m = options.max_range_m;
    const PoseTrack poses = read_raw_poses(drive, frames, options.poses_file, sequence);
    for (std::size_t i = 0; i < frames.size(); ++i)
        add_frame(sequence, frames[i], poses.time_s[i], poses.pose[i]);
    centre_log(sequence);
    if (options.poses_file.empty()) sequence.georeference = read_oxts_place(drive);
    sequence.boxes = read_tracklets(drive / "tracklet_labels.xml", frames, sequence.world_from_vehicle);
    // 10: number of digits in the names of the scan files
    read_hdl64_sweeps(sequence, drive / "velodyne_points/data", 10, options);
    return sequence;
}

}  // namespace relidar
