// SPDX-License-Identifier: Apache-2.0
// Reads KITTI-360. The dataset contains poses of the IMU (x forward, y right, z down).
// The poses of the LiDAR are
//   world_from_velo = world_from_imu * imu_from_cam0 * inverse(velo_from_cam0)
// Scans are not motion-compensated. As in KITTI raw, the time of a pose is the moment
// when the head of the LiDAR faces forward.
#include "read/datasets/kitti/kitti_360.hpp"

#include <algorithm>
#include <map>
#include <optional>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/error.hpp>
#include <relidar/read/clouds.hpp>
#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/list_text.hpp"
#include "read/datasets/kitti/kitti_sweeps.hpp"
#include "read/kitti/log_files.hpp"
#include "read/lidar_rt_benchmark.hpp"
#include "read/readers.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using namespace kitti;

struct DriveRequest {
    std::string name;  ///< name of its folders
    FrameRange frames;
    std::vector<int> test_frames = {};  ///< see DriveFrames
    Notes notes = {};
};

std::vector<std::string> list_drives(const fs::path& folder) {
    std::vector<std::string> names;
    for (const fs::path& drive : list_folder(folder))
        if (does_path_exist(drive / "velodyne_points")) names.push_back(drive.filename().string());
    if (names.empty())
        fail("{}: found no drive, expected folders *_drive_*_sync/velodyne_points", folder.string());
    return names;
}

/// Selects the drive of dataset.sequence, which may also name a part of the benchmark.
DriveRequest choose_drive(const fs::path& folder, const DatasetOptions& options) {
    const std::vector<std::string> drives = list_drives(folder);
    const DriveFrames part = find_drive(options, kKitti360Benchmark);
    if (part.drive.empty()) {
        DriveRequest drive{drives.front(), part.frames};
        if (drives.size() > 1)
            drive.notes = {fmt::format(
                "the first of {} drives is read; use dataset.sequence to select another one", drives.size())};
        return drive;
    }
    for (const std::string& drive : drives)
        if (drive == part.drive || drive.find("_drive_" + part.drive + "_") != std::string::npos)
            return {drive, part.frames, part.test_frames};
    fail<UsageError>(
        "dataset.sequence: found '{}', expected the name or number of a drive in {} ({}), or ks1 to ks4 or "
        "kd1 to kd6, which are the static and dynamic parts of drive 0000 in the LiDAR-RT paper",
        quote(options.sequence), folder.string(), quote(fmt::format("{}", fmt::join(drives, ", "))));
}

/// Returns the LiDAR poses in the world frame, by frame number. Some frames have no pose.
/// The dataset stores IMU poses, so the calibration of both sensors to camera 0 is
/// applied.
std::map<int, Pose> read_lidar_poses(const fs::path& dataset_folder, const std::string& drive_name) {
    const fs::path calibration = dataset_folder / "calibration";
    const Pose imu_from_cam0 = read_transform(calibration / "calib_cam_to_pose.txt", "image_00");
    // This file contains a single line of 12 numbers.
    const Pose velo_from_cam0 = read_matrices(calibration / "calib_cam_to_velo.txt", {0}).front();
    std::map<int, Pose> poses = read_numbered_poses(dataset_folder / "data_poses" / drive_name / "poses.txt");
    for (auto& [frame, pose] : poses) pose = pose * imu_from_cam0 * inverse(velo_from_cam0);
    return poses;
}

/// Returns the pose of a frame. Interpolates a missing pose if its neighbours are at most
/// five frames (half a second) apart, or if the car stands still.
std::optional<Pose> pose_of_frame(const std::map<int, Pose>& poses_by_frame, int frame_number) {
    constexpr int kMaxFrameGap = 5;
    constexpr double kMaxStandingMotion_m = 0.2;
    const auto after = poses_by_frame.lower_bound(frame_number);
    if (after == poses_by_frame.end()) return std::nullopt;
    if (after->first == frame_number) return after->second;
    if (after == poses_by_frame.begin()) return std::nullopt;
    const auto before = std::prev(after);
    const int apart = after->first - before->first;
    if (apart > kMaxFrameGap &&
        glm::distance(before->second.translation, after->second.translation) > kMaxStandingMotion_m)
        return std::nullopt;
    return interpolate(before->second, after->second, double(frame_number - before->first) / apart);
}

/// Adds all frames with a pose to the log. Adds notes for the user about interpolated and
/// missing poses.
void add_posed_frames(Log& sequence, const std::vector<int>& numbers, const std::vector<double>& times_s,
                      const std::map<int, Pose>& poses_by_frame) {
    std::vector<int> between, without;
    for (std::size_t i = 0; i < numbers.size(); ++i) {
        const std::optional<Pose> pose = pose_of_frame(poses_by_frame, numbers[i]);
        if (!pose) without.push_back(numbers[i]);
        else if (!poses_by_frame.contains(numbers[i])) between.push_back(numbers[i]);
        if (pose) add_frame(sequence, numbers[i], times_s[i], *pose);
    }
    if (sequence.frames.empty())
        fail("{}: none of the frames {} to {} has a pose, expected frames between {} and {}", sequence.name,
             numbers.front(), numbers.back(), poses_by_frame.begin()->first, poses_by_frame.rbegin()->first);
    if (!between.empty())
        sequence.notes.push_back(fmt::format(
            "poses of these frames are interpolated, because data_poses does not contain them: {}",
            list_text(between)));
    if (!without.empty())
        sequence.notes.push_back(
            fmt::format("frames that are skipped, because they have no pose: {}", list_text(without)));
}

/// Adds the frames, poses and boxes of a drive. Boxes are in the world of the dataset, so
/// they are omitted if only the user has poses.
void add_kitti_360_frames(Log& sequence, const fs::path& dataset_folder, const DriveRequest& drive,
                          const std::vector<int>& numbers, const fs::path& user_pose_file) {
    const std::vector<double> time_s = read_frame_times(
        dataset_folder / "data_3d_raw" / drive.name / "velodyne_points/timestamps.txt", numbers, sequence);
    if (user_pose_file.empty() || does_path_exist(dataset_folder / "data_poses" / drive.name)) {
        add_posed_frames(sequence, numbers, time_s, read_lidar_poses(dataset_folder, drive.name));
        fs::path labels;  // prefers the folder train_full to the smaller folder train
        for (const char* set : {"train_full", "train"}) {
            const fs::path file = dataset_folder / "data_3d_bboxes" / set / (drive.name + ".xml");
            if (labels.empty() && does_path_exist(file)) labels = file;
        }
        if (labels.empty())
            sequence.notes.push_back("data_3d_bboxes is missing, so this drive has no labels");
        else sequence.boxes = read_360_boxes(labels, sequence.frames);
    } else {
        for (std::size_t i = 0; i < numbers.size(); ++i) add_frame(sequence, numbers[i], time_s[i], {});
        sequence.notes.push_back("data_poses is missing, so the boxes are not read");
    }
}

}  // namespace

Log load_kitti_360(const fs::path& log_folder, const DatasetOptions& options) {
    require_folder(log_folder, "KITTI-360 (data_3d_raw/, data_poses/, calibration/)");
    const fs::path folder = fs::canonical(log_folder);
    const DriveRequest drive = choose_drive(folder / "data_3d_raw", options);
    const fs::path points = folder / "data_3d_raw" / drive.name / "velodyne_points";
    const std::vector<int> frames = list_scans(points / "data", drive.frames.begin, drive.frames.end);

    Log sequence;
    sequence.name = drive.name;
    sequence.source = log_folder.string();
    sequence.conventions =
        "Sensor frame: x forward, y left, z up, in metres. Times are seconds after the first sweep of the "
        "drive. At the time of a frame, the head faces forward. World frame: x east, y north, z up "
        "(Mercator). Scans are not motion-compensated.";
    sequence.notes = drive.notes;
    sequence.test_frames = drive.test_frames;
    const std::string gaps = check_scan_files(points / "data", frames, options.allow_missing_scans);
    if (!gaps.empty()) sequence.notes.push_back(gaps);
    SpinningSensor& sensor = sequence.lidars[0].sensor;
    sensor.name = "HDL-64E fitted to " + sequence.name;
    sensor.period_s = read_time_step_s(points / "timestamps.txt");
    sensor.max_range_m = options.max_range_m;
    add_kitti_360_frames(sequence, folder, drive, frames, options.poses_file);
    replace_poses(sequence, options.poses_file);
    centre_log(sequence);
    // 10: number of digits in the names of the scan files
    read_hdl64_sweeps(sequence, points / "data", 10, options);
    return sequence;
}

}  // namespace relidar
