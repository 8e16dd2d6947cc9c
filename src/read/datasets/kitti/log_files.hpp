// SPDX-License-Identifier: Apache-2.0
// Reads and checks the files of a KITTI raw drive. The KITTI raw development kit
// documents the formats of these files.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/log/log.hpp>
#include <relidar/read/points.hpp>

namespace relidar::kitti {

/// Returns the numbers of the scan files in a folder, in ascending order.
/// @param end_number  first number that is not returned; -1: no limit
/// @throws DataError if the folder or its scans do not exist
/// @throws UsageError if the range contains no scan
std::vector<int> list_scans(const std::filesystem::path& folder, int begin_number, int end_number);

/// Reads the points of a scan file, with the reflectance as intensity. Omits rays without
/// a return.
/// @param label_file  SemanticKITTI labels, 32 bits per point, of which the lower 16 are
/// the class; may not exist
/// @throws DataError if the scan is truncated, empty or invalid, or if the number of
/// labels differs
LidarPoints read_kitti_scan(const std::filesystem::path& file, const std::filesystem::path& label_file = {});

/// Adds a note if scan files are missing.
/// @throws DataError if scan files are missing and allow_missing is false
void note_missing_scans(Log& log, const std::filesystem::path& folder, const std::vector<int>& numbers,
                        bool allow_missing);

/// Returns seconds after the first time in the file. Line i contains the time of frame i.
/// The line is empty if the frame has no scan. Times can cross midnight.
/// @throws DataError if a requested frame has no time, or if times do not increase
/// @param log  gets the date of the log
std::vector<double> read_frame_times(const std::filesystem::path& time_file, const std::vector<int>& numbers,
                                     Log& log);

/// Reads a file in which line i has the time of frame i in seconds.
std::vector<double> read_times_s(const std::filesystem::path& file, const std::vector<int>& numbers);

/// Returns the median duration of a sweep: the time in timestamps_end.txt minus the time
/// in timestamps_start.txt. Uses all lines that both files have.
double read_sweep_s(const std::filesystem::path& drive);

/// Returns the median time between consecutive lines of a timestamp file.
double read_time_step_s(const std::filesystem::path& time_file);

/// Reads a rigid transform from a calibration file. The key R has 9 numbers (row-major).
/// The key T has 3 numbers.
Pose read_calibration(const std::filesystem::path& file);

/// Reads a rigid transform from the line "key: 12 numbers" of a calibration file. The
/// numbers are a 3x4 matrix, row-major.
Pose read_transform(const std::filesystem::path& file, const std::string& key);

/// Returns the rectified cameras image_0 to image_3 of a drive, without those that its
/// calibration lacks. Their rig is the LiDAR.
/// @throws DataError if a file of the calibration is invalid
std::vector<Camera> read_cameras(const std::filesystem::path& drive);

/// Computes the LiDAR poses from GPS/IMU data (OXTS). Uses the Mercator projection at the
/// latitude of the first frame of the log, with x to the east and y to the north. The
/// origin of the world frame is the IMU in that frame.
/// @throws DataError with the file, or with the setting to use if the drive has no OXTS
/// data
std::vector<Pose> read_oxts_poses(const std::filesystem::path& drive, const std::vector<int>& numbers);

/// Returns the place of the world of read_oxts_poses() on the earth.
Georeference read_oxts_place(const std::filesystem::path& drive);

struct OxtsTrack {
    std::vector<Pose> poses;  ///< of the LiDAR
    Georeference place;       ///< of their world
};
/// Same for a file with a line of GPS/IMU data for each frame. The IMU in line 0 is the
/// origin of the world.
OxtsTrack read_oxts_lines(const std::filesystem::path& file, const std::vector<int>& numbers,
                          const Pose& imu_from_sensor);

/// Reads poses by frame number. Each line contains a frame number and a 3x4 matrix. The
/// frame numbers must increase.
std::map<int, Pose> read_numbered_poses(const std::filesystem::path& file);

/// Reads tracklet_labels.xml, if it exists.
/// @param world_from_sensor  sensor poses, one per frame
std::vector<BoxTrack> read_tracklets(const std::filesystem::path& tracklet_file,
                                     const std::vector<int>& numbers, const PoseTrack& world_from_sensor);

}  // namespace relidar::kitti
