// SPDX-License-Identifier: Apache-2.0
// Readers for the files of a KITTI raw drive, which check what they read. Formats: KITTI
// raw development kit.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/log/sequence.hpp>

namespace relidar::kitti {

/// Returns the frame numbers of the scans in a folder within [begin, end), ascending. end
/// -1: no limit.
/// @throws DataError if the folder or its scans do not exist, UsageError if no scan is in
/// the range
std::vector<int> list_scans(const std::filesystem::path& folder, int begin, int end);

/// Reads the points of a scan: x, y, z (metres, sensor frame), reflectance.
/// @throws DataError if the scan is truncated, empty or invalid
std::vector<glm::vec4> read_scan(const std::filesystem::path& file);

/// Describes the missing scans between the first and the last frame. Returns an empty
/// string if none is missing.
/// @throws DataError if scans are missing and allow_missing is false
std::string note_gaps(const std::filesystem::path& folder, const std::vector<int>& frames,
                      bool allow_missing);

/// Explains what a folder is if it is not a drive, and what to use instead: a KITTI
/// odometry sequence, a folder of drives, or a folder within a drive.
/// @param marker  folder that identifies a drive
/// @return an empty string if the folder is none of these
std::string describe_stranger(const std::filesystem::path& folder, const std::string& marker);

/// Reads the times of the given frames in seconds after the file's first time (across
/// days). Frame i is on line i, and lines of missing scans are empty.
/// @throws DataError if a line is not a time, a frame has no time, or times do not
/// increase
std::vector<double> read_times(const std::filesystem::path& file, const std::vector<int>& frames);

/// Returns the median duration of a sweep from timestamps_start.txt and
/// timestamps_end.txt, over the lines that both files have.
double read_period(const std::filesystem::path& drive);

/// Returns the median duration of a sweep from a single timestamp file, as the difference
/// of consecutive lines.
double read_step(const std::filesystem::path& file);

/// Reads a rigid transform with the keys R (9 numbers, row-major) and T (3 numbers).
Pose read_calibration(const std::filesystem::path& file);

/// Reads a rigid transform from a line "key: 12 numbers", 3x4 row-major.
Pose read_transform(const std::filesystem::path& file, const std::string& key);

/// Reads world_from_sensor of the given frames from OXTS: Mercator projection at the
/// latitude of the log's first frame, x east, y north. The origin of the dataset's world
/// is the IMU in the log's first frame.
/// @throws DataError with the file, or with the setting to use if the drive has no OXTS
std::vector<Pose> read_oxts_poses(const std::filesystem::path& drive, const std::vector<int>& frames);

/// Reads world_from_sensor of the given frames: 12 numbers per line, 3x4 row-major, frame
/// i on line i.
std::vector<Pose> read_pose_file(const std::filesystem::path& file, const std::vector<int>& frames);

/// Note of a log that is loaded with kNoPoses.
inline constexpr const char* kNoPosesNote =
    "no poses are read (dataset.poses=none): they have to be found from the scans";

/// Replaces the poses of a sequence by those of DatasetOptions::poses_file. Boxes keep
/// their position relative to the vehicle. Does nothing if the path is empty.
void take_given_poses(Sequence& sequence, const std::filesystem::path& poses_file);

/// Reads poses from a file with a frame number and 12 numbers per line, 3x4 row-major,
/// with increasing frame numbers.
std::map<int, Pose> read_numbered_poses(const std::filesystem::path& file);

/// Reads the boxes of tracklet_labels.xml for the given frames, in the world frame of the
/// poses. Returns none without this file.
/// @param world_from_sensor  one pose per frame
std::vector<BoxTrack> read_tracklets(const std::filesystem::path& file, const std::vector<int>& frames,
                                     const PoseTrack& world_from_sensor);

}  // namespace relidar::kitti
