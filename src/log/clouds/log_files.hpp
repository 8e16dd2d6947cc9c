// SPDX-License-Identifier: Apache-2.0
// The single files of a KITTI raw drive, each checked while read. Formats: KITTI raw
// development kit.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/log/sequence.hpp>

namespace relidar::kitti {

/// Frame numbers of the scans in a folder within [begin, end), ascending; end -1 = open.
/// @throws DataError without that folder or any scan, UsageError where none lies in the
/// range
std::vector<int> list_scans(const std::filesystem::path& folder, int begin, int end);

/// Points of a scan: x, y, z (metres, sensor frame), reflectance. @throws DataError for a
/// truncated, empty or impossible scan
std::vector<glm::vec4> read_scan(const std::filesystem::path& file);

/// Which scans between the first and the last of the frames are missing and left out, in
/// words; empty where none is.
/// @throws DataError where some are missing that may not be
std::string note_gaps(const std::filesystem::path& folder, const std::vector<int>& frames,
                      bool allow_missing);

/// What a folder is that is no drive, and what to give instead: a KITTI odometry
/// sequence, a folder of drives, a folder within one.
/// @param marker  folder that tells a drive @return empty where it is none of these
std::string describe_stranger(const std::filesystem::path& folder, const std::string& marker);

/// Times of the given frames, seconds after the file's first (days included): frame i
/// stands on line i, lines of missing scans are empty.
/// @throws DataError for a line that is no time, a frame without one, or times that do
/// not rise
std::vector<double> read_times(const std::filesystem::path& file, const std::vector<int>& frames);

/// Median time of one sweep from timestamps_start.txt and timestamps_end.txt, over the
/// lines that both have.
double read_period(const std::filesystem::path& drive);

/// Median time of one sweep from a single file of timestamps: from each line to the next.
double read_step(const std::filesystem::path& file);

/// Rigid transform with the keys R (9 numbers, row-major) and T (3).
Pose read_calibration(const std::filesystem::path& file);

/// Rigid transform of a line "key: 12 numbers", 3x4 row-major, of a file of such lines.
Pose read_transform(const std::filesystem::path& file, const std::string& key);

/// world_from_sensor of the given frames from OXTS: Mercator about the latitude of the
/// log's first frame, x east, y north. Dataset's world: origin at the IMU in the log's
/// first frame.
/// @throws DataError naming the file, or the setting that helps where the drive has no
/// OXTS
std::vector<Pose> read_oxts_poses(const std::filesystem::path& drive, const std::vector<int>& frames);

/// world_from_sensor of the given frames: 12 numbers a line, 3x4 row-major, frame i on
/// line i.
std::vector<Pose> read_pose_file(const std::filesystem::path& file, const std::vector<int>& frames);

/// What a log says of itself with kNoPoses.
inline constexpr const char* kNoPosesNote =
    "no poses are read (dataset.poses=none): they have to be found from the scans";

/// Gives a sequence the poses of DatasetOptions::poses_file; its boxes go along. Leaves
/// it as it is where that is empty.
void take_given_poses(Sequence& sequence, const std::filesystem::path& poses_file);

/// Poses of a file with a frame's number and 12 numbers a line, 3x4 row-major, the frames
/// rising.
std::map<int, Pose> read_numbered_poses(const std::filesystem::path& file);

/// Boxes of tracklet_labels.xml for the given frames, in the world of the poses; none
/// without that file.
/// @param world_from_sensor one entry for each of `frames`
std::vector<BoxTrack> read_tracklets(const std::filesystem::path& file, const std::vector<int>& frames,
                                     const PoseTrack& world_from_sensor);

}  // namespace relidar::kitti
