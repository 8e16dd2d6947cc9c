// SPDX-License-Identifier: Apache-2.0
// Reads and checks the files that describe a log in a plain folder; see docs/datasets.md.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <relidar/read/clouds.hpp>
#include <relidar/read/dataset.hpp>

#include "read/files/point_units.hpp"
#include "read/scans/pose_conventions.hpp"
#include "read/scans/scan_plan.hpp"

namespace relidar::read {

inline constexpr const char* kHeadFile = "sequence.json";
inline constexpr const char* kPosesFile = "poses.txt";
inline constexpr const char* kBoxesFile = "boxes.json";
inline constexpr const char* kLogFormat = "relidar log";
inline constexpr int kLogVersion = 1;
// limits of texts, in bytes
inline constexpr std::size_t kLongestName = 200, kLongestText = 10000, kLongestPath = 255;

/// An element of "lidars" in sequence.json.
struct HeaderLidar : LidarScanLayout {
    Lidar lidar;
    std::string scans;  ///< folder with the scan files, if sequence.json does not list frames
};

/// A frame that sequence.json lists, or that was found as a scan file.
struct LogFrame {
    int number = 0;
    double time_s = 0.0;
    int lidar = 0;
    std::filesystem::path scan;
};

/// Contents of sequence.json.
struct FolderHead {
    std::string name, conventions;
    std::int64_t start_unix_ns = 0;
    Notes notes;
    std::vector<HeaderLidar> lidars;
    std::vector<LogFrame> frames;  ///< all frames of the log, sorted by time and LiDAR
    bool motion_compensated = false;
    PointFileUnits units;
    std::optional<glm::dvec3> world_offset_m;
    std::optional<Georeference> georeference;
    std::optional<AzimuthInterval> labelled_azimuth;
};

/// Reads sequence.json. If it does not list the scans, lists the files in the scan
/// folders.
/// @param default_max_range_m  maximum range of sensors for which the file contains none
FolderHead read_header(const std::filesystem::path& folder, double default_max_range_m);

/// Reads the vehicle pose of each frame, if the file exists. Its lines have
/// - 12 numbers: a 3x4 matrix, row-major; line i belongs to frame number i,
/// - 8 numbers: time_s x y z qw qx qy qz, or
/// - 7 numbers: time_s x y z roll pitch yaw.
/// Poses with times are interpolated. If the vehicle then does not drive forward, other
/// meanings of the numbers are tested, such as another order of the quaternion.
/// @param read_scan_pairs_for_pose_check  reads pairs of scans that confirm a meaning;
/// may be null
/// @param log  gets notes, and the conventions of the poses
std::optional<std::vector<Pose>> load_poses(const std::filesystem::path& file,
                                            const std::vector<LogFrame>& frames,
                                            const ScanPairReader& read_scan_pairs_for_pose_check,
                                            const Conventions& set, Log& log);

/// Reads boxes.json, if it exists. Ignores labels outside the time of the loaded frames.
/// @param all_frames  all frames of the log, because labels can refer to frames by number
std::vector<BoxTrack> read_box_tracks(const std::filesystem::path& box_file,
                                      const std::vector<LogFrame>& loaded_frames,
                                      const std::vector<LogFrame>& all_frames);

/// Reads the scans of all frames from files with read_scans(). Estimates missing units.
/// @param scan_files  [frames] scan file of each frame
void read_scan_files(Log& log, ScanLayout layout, PointFileUnits units,
                     const std::vector<std::filesystem::path>& scan_files, const DatasetOptions& options);

}  // namespace relidar::read
