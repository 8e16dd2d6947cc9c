// SPDX-License-Identifier: Apache-2.0
// Reads KITTI raw and KITTI odometry. Scans of KITTI raw are not motion-compensated, so
// the reader computes the firing time of each ray. KITTI odometry contains poses of the
// left camera (z forward). The transform cam_T_velo (Tr in calib.txt) converts them to
// poses of the LiDAR:
//   world_from_sensor(i) = inverse(Tr) * pose(i) * Tr
#include "read/readers.hpp"

#include <algorithm>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/log/camera.hpp>
#include <relidar/read/clouds.hpp>
#include "base/fail.hpp"
#include "base/files.hpp"
#include "log/frames/labelled_azimuth.hpp"
#include "read/datasets/kitti/kitti_sweeps.hpp"
#include "read/datasets/kitti/log_files.hpp"
#include "read/scans/pose_files.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using namespace kitti;

/// Reads the times of frames in seconds, or returns those of a LiDAR of 10 Hz.
std::vector<double> read_odometry_times(const fs::path& file, const std::vector<int>& numbers, Notes& notes) {
    if (!does_path_exist(file)) {
        notes.push_back("times.txt is missing, so frames are 0.1 s apart");
        std::vector<double> time_s;
        for (const int number : numbers) time_s.push_back(0.1 * number);
        return time_s;
    }
    return read_times_s(file, numbers);
}

/// Returns the file with the camera poses of an odometry log: poses.txt in its
/// folder (SemanticKITTI), or ../../poses/NN.txt (KITTI).
/// @throws DataError without both; sequences 11 to 21 have no published poses
fs::path find_pose_file(const fs::path& sequence_folder) {
    const fs::path semantic_kitti = sequence_folder / "poses.txt",
                   kitti = sequence_folder.parent_path().parent_path() / "poses" /
                           (sequence_folder.filename().string() + ".txt");
    if (does_path_exist(semantic_kitti)) return semantic_kitti;
    if (does_path_exist(kitti)) return kitti;
    fail(
        "neither {} nor {} exists, expected the poses of the camera; use dataset.poses=FILE for poses of the "
        "LiDAR, or dataset.poses=none to estimate the poses from the scans",
        semantic_kitti.string(), kitti.string());
}

/// Returns the transform from the LiDAR to the camera. Without calib.txt, chooses the
/// axes of the poses by the direction of the drive.
Pose find_cam_from_velo(const fs::path& sequence_folder, const std::vector<Pose>& poses, Notes& notes) {
    if (does_path_exist(sequence_folder / "calib.txt"))
        return read_transform(sequence_folder / "calib.txt", "Tr");
    glm::dvec3 moved_m(0.0);  // in the frame of each pose
    for (std::size_t i = 1; i < poses.size(); ++i)
        moved_m += glm::abs((inverse(poses[i - 1]) * poses[i]).translation);
    const bool is_camera = moved_m.z > moved_m.x;
    notes.push_back(
        fmt::format("calib.txt is missing: the poses move along {}, so they are read as poses of {}",
                    is_camera ? "z" : "x", is_camera ? "a camera at the origin of the LiDAR" : "the LiDAR"));
    return is_camera ? Pose{glm::dquat(0.5, 0.5, -0.5, 0.5), {}} : Pose{};
}

std::vector<Pose> read_odometry_poses(const fs::path& sequence_folder, const std::vector<int>& numbers,
                                      Notes& notes) {
    std::vector<Pose> poses = read::read_matrices(find_pose_file(sequence_folder), numbers);
    const Pose cam_from_velo = find_cam_from_velo(sequence_folder, poses, notes);
    // Camera poses become LiDAR poses. The world becomes the LiDAR frame of frame 0.
    for (Pose& pose : poses) pose = inverse(cam_from_velo) * pose * cam_from_velo;
    return poses;
}

constexpr int kRawDigits = 10;  // digits of the scan numbers in file names

}  // namespace

/// Loads a drive of KITTI raw: times, poses from GPS/IMU (OXTS), boxes and scans.
Log load_kitti_raw(const fs::path& folder, const DatasetOptions& options) {
    require_folder(folder, "a KITTI raw drive (velodyne_points/)");
    const fs::path drive = fs::canonical(folder), points = drive / "velodyne_points";
    if (drive.parent_path().filename() == "data_3d_raw")
        fail("{} is a drive of KITTI-360; use {} with dataset.sequence={}", folder.string(),
             drive.parent_path().parent_path().string(), drive.filename().string());
    const std::vector<int> frames = list_scans(points / "data", options.frames.begin, options.frames.end);
    Log log;  // with one LiDAR
    log.name = drive.filename().string();
    log.source = folder.string();
    log.conventions = fmt::format(
        "Sensor frame: x forward, y left, z up, in metres. Times are seconds after the first sweep of the "
        "log. At the time of a frame, the head faces forward. The log has poses from {}. Scans are not "
        "motion-compensated. Boxes are labelled only in the view of the front camera.",
        options.poses_file.empty() ? "OXTS (Mercator)" : options.poses_file.string());
    log.cameras = read_cameras(drive);
    note_missing_scans(log, points / "data", frames, options.allow_missing_scans);
    if (!does_path_exist(drive / "tracklet_labels.xml"))
        log.notes.push_back("tracklet_labels.xml is missing, so this drive has no labels");
    log.lidars[0].sensor.period_s = read_sweep_s(drive);
    const std::vector<double> time_s = read_frame_times(points / "timestamps.txt", frames, log);
    std::vector<Pose> poses(frames.size());
    if (options.poses_file.empty()) poses = read_oxts_poses(drive, frames);
    for (std::size_t i = 0; i < frames.size(); ++i) add_frame(log, frames[i], time_s[i], poses[i]);
    // Tracklets are relative to the vehicle, so they are read when its poses are final.
    read::replace_poses(log, options);
    centre_log(log);
    if (options.poses_file.empty()) log.georeference = read_oxts_place(drive);
    log.boxes = read_tracklets(drive / "tracklet_labels.xml", frames, log.world_from_vehicle);
    const auto front = std::ranges::find(log.cameras, "image_2", &Camera::name);
    if (!log.boxes.empty())
        log.labelled_azimuth = view_azimuths(front == log.cameras.end() ? kitti_camera() : *front);
    read_hdl64_sweeps(log, points / "data", kRawDigits, options);
    return log;
}

/// Loads a log of KITTI odometry: times, poses of the camera, and scans, which are
/// motion-compensated. Labels of points exist if it is from SemanticKITTI.
Log load_odometry(const fs::path& log_folder, const DatasetOptions& options) {
    require_folder(log_folder, "a KITTI odometry sequence (velodyne/, calib.txt, times.txt)");
    const fs::path folder = fs::canonical(log_folder);
    const std::vector<int> frames = list_scans(folder / "velodyne", options.frames.begin, options.frames.end);
    if (!does_path_exist(folder / "calib.txt") && !does_path_exist(folder / "poses.txt") &&
        options.poses_file.empty())
        fail(
            "{} is a KITTI odometry sequence with motion-compensated scans; expected also its file "
            "calib.txt, or "
            "the KITTI raw drive from which the sequence was made",
            folder.string());
    Log log;
    log.notes = {"this log has no labels"};
    const std::vector<double> time_s = read_odometry_times(folder / "times.txt", frames, log.notes);
    std::vector<Pose> poses(frames.size());
    if (options.poses_file.empty()) poses = read_odometry_poses(folder, frames, log.notes);
    log.name = "KITTI odometry " + folder.filename().string();
    log.source = log_folder.string();
    log.conventions =
        "Sensor frame: x forward, y left, z up, in metres. Times are the seconds in times.txt. The world "
        "frame is the LiDAR frame of frame 0. Scans are motion-compensated. The dataset has no boxes.";
    log.rolling_shutter = false;
    for (std::size_t i = 0; i < frames.size(); ++i) add_frame(log, frames[i], time_s[i], poses[i]);
    read::replace_poses(log, options);
    centre_log(log);
    read_kitti_sweeps(log, folder / "velodyne", options, /*hdl64_is_moved=*/true, folder / "labels");
    return log;
}

}  // namespace relidar
