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
/// numbers from `begin` to `end` - 1. If end is -1, the numbers have no upper limit.
/// @throws DataError if the folder or its scans do not exist
/// @throws UsageError if the range contains no scan
std::vector<int> list_scans(const std::filesystem::path& folder, int begin, int end);

/// Points of a scan file.
struct ScanPoints {
    std::vector<glm::vec4> points;      ///< x, y, z in metres in the sensor frame, and reflectance
    std::vector<SurfaceClass> classes;  ///< [points] classes; empty if the points have no labels
};
/// Reads the points of a scan file. Omits rays without a return.
/// @param labels  file with the SemanticKITTI labels of all points: 32 bits per point, of
/// which the lower 16 are the class. If the file does not exist, the points have no
/// labels.
/// @throws DataError if the scan is truncated, empty or invalid, or if the labels have
/// another number of points
ScanPoints read_scan(const std::filesystem::path& file, const std::filesystem::path& labels = {});

/// Returns a note for the user about missing scan files between the first and the last
/// frame. Returns an empty string if no scan file is missing.
/// @throws DataError if scan files are missing and allow_missing is false
std::string format_frame_gaps(const std::filesystem::path& folder, const std::vector<int>& frames,
                              bool allow_missing);

/// Returns an error message for a folder that is not a KITTI drive. The message names the
/// folder to use instead. Recognises an odometry sequence, a folder of drives, and a
/// folder inside a drive.
/// @param marker  subfolder that every drive has
/// @return empty string if the folder is none of these
std::string describe_unknown_folder(const std::filesystem::path& folder, const std::string& marker);

/// Reads the times of some frames, in seconds after the first time in the file. Line i
/// contains the time of frame i, and is empty if this scan is missing. Times can cross
/// midnight.
/// @throws DataError if a line is not a time, if a frame has no time, or if times do not
/// increase
std::vector<double> read_times(const std::filesystem::path& file, const std::vector<int>& frames);

/// Returns the median duration of a sweep. The duration is the time in timestamps_end.txt
/// minus the time in timestamps_start.txt, for each line that both files have.
double read_period(const std::filesystem::path& drive);

/// Returns the duration of a sweep: the median time between consecutive lines of a
/// timestamp file.
double read_step(const std::filesystem::path& file);

/// Reads a rigid transform from a calibration file. The key R has 9 numbers (row-major).
/// The key T has 3 numbers.
Pose read_calibration(const std::filesystem::path& file);

/// Reads a rigid transform from the line "key: 12 numbers" of a calibration file. The 12
/// numbers are a 3x4 matrix, row-major.
Pose read_transform(const std::filesystem::path& file, const std::string& key);

/// Computes the LiDAR poses of some frames from GPS/IMU data (OXTS). Uses the Mercator
/// projection at the latitude of the first frame of the log, with x to the east and y to
/// the north. The origin of the world frame is the IMU in that frame.
/// @throws DataError with the file. If the drive has no OXTS data, the message names the
/// setting to use instead.
std::vector<Pose> read_oxts_poses(const std::filesystem::path& drive, const std::vector<int>& frames);

/// Reads LiDAR poses from a file. Line i contains the pose of frame i as 12 numbers: a
/// 3x4 matrix, row-major.
/// @param frames  frames whose poses are returned
std::vector<Pose> read_pose_file(const std::filesystem::path& file, const std::vector<int>& frames);

/// Reads LiDAR poses from a file of the user. The file contains matrices as in
/// read_pose_file(), or poses with times as in folder::read_poses().
/// @param time_s  [frames] times of the frames
std::vector<Pose> read_user_poses(const std::filesystem::path& file, const std::vector<int>& frames,
                                  const std::vector<double>& time_s, std::vector<std::string>& notes);

/// Note for a user who requested to load a log without its poses.
inline constexpr const char* kNoPosesNote =
    "poses are not read (dataset.poses=none); they must be estimated from the scans";

/// Replaces the vehicle poses of a log by poses from a file of the user. Boxes keep their
/// positions relative to the vehicle. Does nothing if no file is given.
void use_pose_file(Sequence& sequence, const std::filesystem::path& poses_file);

/// Reads poses from a file. Each line contains a frame number and a 3x4 matrix (12
/// numbers, row-major). The frame numbers must increase.
std::map<int, Pose> read_numbered_poses(const std::filesystem::path& file);

/// Reads the labelled boxes in tracklet_labels.xml and converts them to the world frame.
/// Returns no boxes if the file does not exist.
/// @param frames  frames for which boxes are read
/// @param world_from_sensor  sensor poses, one per frame
std::vector<BoxTrack> read_tracklets(const std::filesystem::path& file, const std::vector<int>& frames,
                                     const PoseTrack& world_from_sensor);

}  // namespace relidar::kitti
