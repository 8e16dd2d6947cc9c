// SPDX-License-Identifier: Apache-2.0
// Reads KITTI odometry. The dataset contains poses of the left camera (z forward). The
// transform cam_T_velo (Tr in calib.txt) converts them to poses of the LiDAR:
//   world_from_sensor(i) = inverse(Tr) * pose(i) * Tr
// The world frame is the frame of the LiDAR in frame 0, with z up.
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

/// Line i contains the time of frame i.
std::vector<double> read_times_s(const fs::path& file, const std::vector<int>& numbers) {
    const std::vector<std::string> lines = split_lines(read_text_file(file));
    std::vector<double> time_s;
    for (const int frame : numbers) {
        const std::size_t line = std::size_t(frame);
        if (line >= lines.size())
            fail("{}: found {} lines, but frame {} needs line {}", file.string(), lines.size(), frame,
                 line + 1);
        const auto seconds = parse_number(trim(lines[line]));
        if (!seconds)
            fail("{} line {}: found '{}', expected a time in seconds", file.string(), line + 1,
                 quote(lines[line]));
        time_s.push_back(*seconds);
    }
    return time_s;
}

/// Returns poses.txt in the folder (SemanticKITTI), or ../../poses/NN.txt (KITTI).
/// Sequences 11 to 21 have no published poses.
fs::path find_pose_file(const fs::path& sequence_folder) {
    const fs::path here = sequence_folder / "poses.txt",
                   beside = sequence_folder.parent_path().parent_path() / "poses" /
                            (sequence_folder.filename().string() + ".txt");
    if (does_path_exist(here)) return here;
    if (does_path_exist(beside)) return beside;
    fail(
        "neither {} nor {} exists, expected the poses of the camera; use dataset.poses=FILE for poses of the "
        "LiDAR, or dataset.poses=none to estimate the poses from the scans",
        here.string(), beside.string());
}

std::vector<Pose> read_odometry_poses(const fs::path& sequence_folder, const std::vector<int>& numbers,
                                      const std::vector<double>& times_s, const fs::path& user_pose_file,
                                      Notes& notes) {
    if (user_pose_file == kNoPoses) return std::vector<Pose>(numbers.size());
    if (!user_pose_file.empty()) return kitti::read_user_poses(user_pose_file, numbers, times_s, notes);
    const Pose cam_from_velo = kitti::read_transform(sequence_folder / "calib.txt", "Tr");
    std::vector<Pose> poses = kitti::read_matrices(find_pose_file(sequence_folder), numbers);
    // Camera poses become LiDAR poses. The world becomes the LiDAR frame of frame 0.
    for (Pose& pose : poses) pose = inverse(cam_from_velo) * pose * cam_from_velo;
    return poses;
}

}  // namespace

Log load_odometry(const fs::path& log_folder, const DatasetOptions& options) {
    require_folder(log_folder, "a KITTI odometry sequence (velodyne/, calib.txt, times.txt)");
    const fs::path folder = fs::canonical(log_folder);
    const std::vector<int> frames =
        kitti::list_scans(folder / "velodyne", options.frames.begin, options.frames.end);
    const std::vector<double> time_s = read_times_s(folder / "times.txt", frames);
    Notes pose_notes;
    const std::vector<Pose> poses =
        read_odometry_poses(folder, frames, time_s, options.poses_file, pose_notes);
    Log sequence;
    sequence.name = "KITTI odometry " + folder.filename().string();
    sequence.source = log_folder.string();
    sequence.conventions =
        "Sensor frame: x forward, y left, z up, in metres. Times are the seconds in times.txt. The world "
        "frame is the LiDAR frame of frame 0. Scans are motion-compensated. The dataset has no boxes.";
    sequence.notes = {"this log has no labels"};
    sequence.notes.insert(sequence.notes.end(), pose_notes.begin(), pose_notes.end());
    if (options.poses_file == kNoPoses) sequence.notes.push_back(kitti::kNoPosesNote);
    sequence.rolling_shutter = false;
    sequence.lidars[0].sensor.name = "HDL-64E fitted to " + sequence.name;
    sequence.lidars[0].sensor.max_range_m = options.max_range_m;
    for (std::size_t i = 0; i < frames.size(); ++i) add_frame(sequence, frames[i], time_s[i], poses[i]);
    centre_log(sequence);
    // 6: number of digits in the names of the scan files
    kitti::read_hdl64_sweeps(sequence, folder / "velodyne", 6, options, folder / "labels");
    return sequence;
}

}  // namespace relidar
