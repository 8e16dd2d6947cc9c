// SPDX-License-Identifier: Apache-2.0
// Reads and checks the files of a KITTI raw drive. The KITTI raw development kit
// describes the formats.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/log/sequence.hpp>

namespace relidar::kitti {

/// Lists the numbers of the scan files in a folder within [begin, end), in ascending
/// order. If end is -1, there is no upper limit.
/// @throws DataError if the folder or its scans do not exist
/// @throws UsageError if no scan is in the range
std::vector<int> list_scans(const std::filesystem::path& folder, int begin, int end);

/// Reads the points of a scan file: x, y, z (metres, sensor frame), reflectance. Leaves
/// out rays without a return.
/// @throws DataError if the scan is truncated, empty or invalid
std::vector<glm::vec4> read_scan(const std::filesystem::path& file);

/// Returns a note about missing scan files between the first and the last frame. Returns
/// an empty string if none is missing.
/// @throws DataError if scans are missing and allow_missing is false
std::string note_gaps(const std::filesystem::path& folder, const std::vector<int>& frames,
                      bool allow_missing);

/// Explains what a folder is if it is not a drive, and which folder to use instead.
/// Recognises a KITTI odometry sequence, a folder of drives, and a folder inside a drive.
/// @param marker  subfolder that identifies a drive
/// @return an empty string if the folder is none of these
std::string describe_stranger(const std::filesystem::path& folder, const std::string& marker);

/// Reads the times of some frames in seconds after the first time in the file. A drive
/// may continue after midnight. Frame i is on line i. The line of a missing scan is
/// empty.
/// @throws DataError if a line is not a time, a frame has no time, or times do not
/// increase
std::vector<double> read_times(const std::filesystem::path& file, const std::vector<int>& frames);

/// Returns the median duration of a sweep: timestamps_end.txt minus timestamps_start.txt,
/// for all lines that both files have.
double read_period(const std::filesystem::path& drive);

/// Returns the median difference between consecutive lines of a timestamp file. It is the
/// duration of a sweep.
double read_step(const std::filesystem::path& file);

/// Reads a rigid transform from a calibration file. The key R has 9 numbers (row-major),
/// the key T has 3 numbers.
Pose read_calibration(const std::filesystem::path& file);

/// Reads a rigid transform from the line "key: 12 numbers" of a calibration file. The
/// numbers are a 3x4 matrix, row-major.
Pose read_transform(const std::filesystem::path& file, const std::string& key);

/// Computes the LiDAR poses of some frames from GPS/IMU data (OXTS). Uses the Mercator
/// projection at the latitude of the log's first frame: x east, y north. The origin of
/// the world is the IMU in that frame.
/// @throws DataError with the file; if the drive has no OXTS data, with the setting to
/// use instead
std::vector<Pose> read_oxts_poses(const std::filesystem::path& drive, const std::vector<int>& frames);

/// Reads the LiDAR poses of some frames from a file. Line i has the pose of frame i as 12
/// numbers: a 3x4 matrix, row-major.
std::vector<Pose> read_pose_file(const std::filesystem::path& file, const std::vector<int>& frames);

/// Note that is added to a log if the user has requested to load it without poses.
inline constexpr const char* kNoPosesNote =
    "no poses are read (dataset.poses=none): they have to be found from the scans";

/// Replaces the vehicle poses by the poses in DatasetOptions::poses_file. Boxes keep
/// their position relative to the vehicle. Does nothing if the option is empty.
void use_pose_file(Sequence& sequence, const std::filesystem::path& poses_file);

/// Reads poses from a file. A line has a frame number and 12 numbers: a 3x4 matrix,
/// row-major. Frame numbers increase.
std::map<int, Pose> read_numbered_poses(const std::filesystem::path& file);

/// Reads the boxes of tracklet_labels.xml at the given frames and converts them to the
/// world frame. Returns none if the file does not exist.
/// @param world_from_sensor  sensor poses, one per frame
std::vector<BoxTrack> read_tracklets(const std::filesystem::path& file, const std::vector<int>& frames,
                                     const PoseTrack& world_from_sensor);

}  // namespace relidar::kitti
