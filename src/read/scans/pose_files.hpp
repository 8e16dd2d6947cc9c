// SPDX-License-Identifier: Apache-2.0
// Reads poses as 3x4 matrices, and the poses of the user (dataset.poses).
#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <vector>

#include <relidar/log/log.hpp>
#include <relidar/read/dataset.hpp>

#include "read/scans/pose_conventions.hpp"

namespace relidar::read {

/// Parses a line of `count` finite numbers.
std::vector<double> parse_finite(const std::string& line, std::size_t count, const std::string& place);
/// Parses a line of 12 numbers: a 3x4 matrix, row-major.
Pose parse_pose(const std::string& line, const std::string& place);

/// A line of a text file, and the name of the file and its number for error messages.
struct FrameLine {
    std::string text, where;
};
/// Returns line i of a file for each frame i.
std::vector<FrameLine> read_frame_lines(const std::filesystem::path& file, const std::vector<int>& numbers);

/// Reads poses. Line i contains the pose of frame i as 12 numbers: a 3x4 matrix,
/// row-major.
std::vector<Pose> read_matrices(const std::filesystem::path& pose_file, const std::vector<int>& numbers);

inline const Note kNoPosesNote{
    "no_poses", -1, "poses are not read (dataset.poses=none); they must be estimated from the scans"};

/// Replaces the vehicle poses of a log by the poses in a file of the user: a matrix for
/// each frame, or poses with times. The boxes move with the vehicle.
/// @param options  poses_file empty: does nothing; "none": sets identity poses
/// @param read_scan_pairs  reads scans that show which meaning of the poses fits
void replace_poses(Log& log, const DatasetOptions& options, const ScanPairReader& read_scan_pairs = nullptr);

}  // namespace relidar::read
