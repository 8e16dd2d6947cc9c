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
/// numbers in [begin, end). If end is -1, the range has no upper limit.
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

/// Returns a note about missing scan files between the first and the last frame. Returns
/// an empty string if no scan file is missing.
/// @throws DataError if scan files are missing and allow_missing is false
std::string note_gaps(const std::filesystem::path& folder, const std::vector<int>& frames,
                      bool allow_missing);

/// Returns an error message for a folder that is not a drive. The message says what the
/// folder is and which folder to use instead. Recognises a KITTI odometry sequence, a
/// folder of drives, and a folder inside a drive.
/// @param marker  subfolder that every drive has
/// @return empty string if the folder is none of these
std::string describe_stranger(const std::filesystem::path& folder, const std::string& marker);

/// Reads the times of some frames, in seconds after the first time in the file. Line i
/// contains the time of frame i. The line of a missing scan is empty. A drive may
/// continue after midnight.
/// @throws DataError if a line is not a time, if a frame has no time, or if times do not
/// increase
std::vector<double> read_times(const std::filesystem::path& file, const std::vector<int>& frames);

/// Returns the median duration of a sweep: the time in timestamps_end.txt minus the time
/// in timestamps_start.txt. Uses all lines that exist in both files.
double read_period(const std::filesystem::path& drive);

/// Returns the duration of a sweep. It is the median difference between consecutive lines
/// of a timestamp file.
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

/// Reads the LiDAR poses of some frames from a file. Line i contains the pose of frame i
/// as 12 numbers: a 3x4 matrix, row-major.
std::vector<Pose> read_pose_file(const std::filesystem::path& file, const std::vector<int>& frames);

/// Reads the LiDAR poses of some frames from a file of the user: matrices as in
/// read_pose_file(), or poses with times (see folder::read_poses()).
/// @param time_s  [frames] times of the frames
std::vector<Pose> read_user_poses(const std::filesystem::path& file, const std::vector<int>& frames,
                                  const std::vector<double>& time_s, std::vector<std::string>& notes);

/// Note that is added to a log if the user requested to load it without poses.
inline constexpr const char* kNoPosesNote =
    "poses are not read (dataset.poses=none); they must be estimated from the scans";

/// Replaces the vehicle poses of a log by the poses in the file
/// DatasetOptions::poses_file. Keeps the positions of boxes relative to the vehicle. Does
/// nothing if the option is empty.
void use_pose_file(Sequence& sequence, const std::filesystem::path& poses_file);

/// Reads poses from a file. Each line contains a frame number and 12 numbers: a 3x4
/// matrix, row-major. The frame numbers must increase.
std::map<int, Pose> read_numbered_poses(const std::filesystem::path& file);

/// Reads the boxes in tracklet_labels.xml and converts them to the world frame. Returns
/// no boxes if the file does not exist.
/// @param frames  frames for which boxes are read
/// @param world_from_sensor  sensor poses, one per frame
std::vector<BoxTrack> read_tracklets(const std::filesystem::path& file, const std::vector<int>& frames,
                                     const PoseTrack& world_from_sensor);

}  // namespace relidar::kitti
