// SPDX-License-Identifier: Apache-2.0
// Reads and checks the files of a KITTI raw drive. The KITTI raw development kit
// documents the formats of these files.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/log/sequence.hpp>

namespace relidar::kitti {

/// Returns the numbers of the scan files in a folder, in ascending order. Returns only
/// numbers from `begin_number` to `end_number` - 1. If `end_number` is -1, there is no
/// upper limit.
/// @throws DataError if the folder or its scans do not exist
/// @throws UsageError if the range contains no scan
std::vector<int> list_scan_numbers(const std::filesystem::path& folder, int begin_number, int end_number);

/// Points of a scan file.
struct ScanPoints {
    std::vector<glm::vec4> points;      ///< x, y, z in metres in the sensor frame, and reflectance
    std::vector<SurfaceClass> classes;  ///< [points] classes; empty if the points have no labels
};
/// Reads the points of a scan file. Omits rays without a return.
/// @param label_file  file with the SemanticKITTI labels of all points: 32 bits per
/// point, of which the lower 16 are the class. If the file does not exist, the points
/// have no labels.
/// @throws DataError if the scan is truncated, empty or invalid, or if the labels have
/// another number of points
ScanPoints read_kitti_scan_points(const std::filesystem::path& scan_file,
                                  const std::filesystem::path& label_file = {});

/// Returns a note for the user about missing scan files between the first and the last
/// frame. Returns an empty string if no scan file is missing.
/// @throws DataError if scan files are missing and allow_missing is false
std::string describe_or_reject_missing_scan_files(const std::filesystem::path& folder,
                                                  const std::vector<int>& frame_numbers, bool allow_missing);

/// Returns an error message for a folder that is not a KITTI drive. The message names the
/// folder to use instead. Recognises three cases: an odometry sequence, a folder of
/// drives, and a folder inside a drive.
/// @param expected_subfolder  subfolder that every drive has
/// @return empty string in all other cases
std::string describe_mistaken_kitti_folder(const std::filesystem::path& folder,
                                           const std::string& expected_subfolder);

/// Reads the times of some frames, in seconds after the first time in the file. Line i
/// contains the time of frame i. The line is empty if the frame has no scan. Times can
/// cross midnight.
/// @throws DataError if a line is not a time, if a requested frame has no time, or if
/// times do not increase
/// @param conventions  gets the sentence of format_log_start()
std::vector<double> read_relative_frame_times_s(const std::filesystem::path& time_file,
                                                const std::vector<int>& frame_numbers,
                                                std::string& conventions);

/// Returns the median duration of a sweep: the time in timestamps_end.txt minus the time
/// in timestamps_start.txt. Uses all lines that both files have.
double read_median_sweep_duration_s(const std::filesystem::path& drive_folder);

/// Returns the duration of a sweep: the median time between consecutive lines of a
/// timestamp file.
double read_median_time_step_s(const std::filesystem::path& time_file);

/// Reads a rigid transform from a calibration file. The key R has 9 numbers (row-major).
/// The key T has 3 numbers.
Pose read_calibration_transform(const std::filesystem::path& file);

/// Reads a rigid transform from the line "key: 12 numbers" of a calibration file. The 12
/// numbers are a 3x4 matrix, row-major.
Pose read_transform_of_key(const std::filesystem::path& file, const std::string& key);

/// Computes the LiDAR poses of some frames from GPS/IMU data (OXTS). Uses the Mercator
/// projection at the latitude of the first frame of the log, with x to the east and y to
/// the north. The origin of the world frame is the IMU in that frame.
/// @throws DataError with the file. If the drive has no OXTS data, the message names the
/// setting to use instead.
std::vector<Pose> compute_lidar_poses_from_oxts_files(const std::filesystem::path& drive_folder,
                                                      const std::vector<int>& frame_numbers);

/// Reads LiDAR poses from a file. Line i contains the pose of frame i as 12 numbers: a
/// 3x4 matrix, row-major.
/// @param frame_numbers  frames whose poses are returned
std::vector<Pose> read_pose_matrices(const std::filesystem::path& pose_file,
                                     const std::vector<int>& frame_numbers);

/// Reads LiDAR poses from a file of the user. The file contains a matrix per line (as in
/// read_pose_matrices()), or poses with times (as in folder::read_frame_poses()).
/// @param frame_times_s  [frames] times of the frames
std::vector<Pose> read_user_pose_file(const std::filesystem::path& pose_file,
                                      const std::vector<int>& frame_numbers,
                                      const std::vector<double>& frame_times_s, Notes& notes);

/// Note for the user if the setting dataset.poses=none was used.
inline const Note kNoPosesNote{
    "no_poses", -1, "poses are not read (dataset.poses=none); they must be estimated from the scans"};

/// Replaces the vehicle poses of a log by the poses in a file of the user. The boxes move
/// with the vehicle. Does nothing if no file is given.
void replace_vehicle_poses_from_file(LidarSequence& sequence, const std::filesystem::path& pose_file);

/// Reads poses from a file. Each line contains a frame number and a 3x4 matrix (12
/// numbers, row-major). The frame numbers must increase.
std::map<int, Pose> read_poses_by_frame_number(const std::filesystem::path& file);

/// Reads the labelled boxes in tracklet_labels.xml and converts them to the world frame.
/// Returns no boxes if the file does not exist.
/// @param frame_numbers  frames for which boxes are read
/// @param world_from_sensor  sensor poses, one per frame
std::vector<BoxTrack> read_tracklet_boxes(const std::filesystem::path& tracklet_file,
                                          const std::vector<int>& frame_numbers,
                                          const PoseTrack& world_from_sensor);

}  // namespace relidar::kitti
