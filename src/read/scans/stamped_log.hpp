// SPDX-License-Identifier: Apache-2.0
// Reads logs whose scan files are named by time stamps, and whose poses have other time
// stamps. Used for Boreas, MulRan and ONCE.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <relidar/read/dataset.hpp>

#include "read/files/point_table.hpp"
#include "read/scans/folder_head.hpp"
#include "read/scans/point_meaning.hpp"

namespace relidar::read {

/// Scan file whose name is its time stamp.
struct StampedScanFile {
    int number = 0;          ///< number of the scan's frame
    std::int64_t stamp = 0;  ///< time of the scan in the unit of the dataset
    std::filesystem::path file;
};
/// Parses a time stamp of digits only, for example from a file name.
std::optional<std::int64_t> parse_stamp(std::string_view text);
/// Lists the files of a folder that are named by their time stamps, sorted by time and
/// numbered from 0.
/// @throws DataError if the folder contains no such file
std::vector<StampedScanFile> list_stamped_files(const std::filesystem::path& folder,
                                                const std::string& extension = ".bin");

/// A line of a table of poses.
struct PoseRow {
    std::int64_t stamp = 0;
    std::vector<double> values;  ///< the numbers after the time stamp; all are finite
    std::string where;           ///< name of the file and line number, for error messages
};
/// Reads a CSV table whose lines contain a time stamp and numbers. Skips a header line,
/// and repeated lines with the same time stamp.
/// @throws DataError with file and line, also if time stamps decrease
std::vector<PoseRow> read_stamped_rows(const std::filesystem::path& file, std::size_t min_values_per_row);

/// Direction in which a vehicle drives, measured in the frame of its sensor.
struct DrivingDirection {
    /// Mean of the unit vectors between consecutive positions; its length is at most 1.
    glm::dvec3 mean{0.0};
    double rise_spread = 0.0;  ///< standard deviation of the z components of the unit vectors
    std::size_t n_steps = 0;   ///< number of position changes of at least one metre
};
/// Returns the mean direction of motion in the sensor frame. Ignores short steps, because
/// errors of the poses would dominate them.
DrivingDirection driving_direction(const PoseTrack& world_from_sensor);
/// Adds a warning if the vehicle does not seem to drive forward, because the poses are
/// then probably wrong.
/// @param forward_fraction  x component of the mean driving direction
void note_driving(Notes& notes, double forward_fraction);

/// The scan files and poses of a log, without the points.
struct StampedLog {
    double unit_s = 1.0;                 ///< unit of the time stamps in seconds
    std::vector<StampedScanFile> scans;  ///< all scans of the log; the time of the first scan is 0 s
    PoseTrack world_from_vehicle;        ///< poses with separate times
    std::filesystem::path poses_file;    ///< file of the poses
    /// Maximum time in seconds between two poses for interpolation.
    double most_gap_s = 0.0;
    /// A scan is used only if poses are known this many seconds before and after it.
    double pose_margin_s = 0.0;

    double seconds_of(std::int64_t stamp) const { return double(stamp - scans[0].stamp) * unit_s; }
};
/// Adds the scans of the requested range to the log as frames. Moves the origin of the
/// world near the log. Skips scans without a pose and adds a note.
/// @return files of the scans
/// @throws UsageError if the range contains no scan
/// @throws DataError if no scan in the range has a pose
std::vector<std::filesystem::path> add_frames(Log& log, const StampedLog& stamped,
                                              const DatasetOptions& options);

/// Checks that the log has a pose file, or that the user selects another source of poses.
/// @throws DataError if there are no poses
void check_pose_source(const std::filesystem::path& pose_file, const DatasetOptions& options);

/// How the scan files of a dataset store their points.
struct FileFormat {
    PointFileUnits units;
    double sweep_duration_s = 0.1;  ///< duration of a sweep in seconds; used if the points have no times
    double turned_rad = 0.0;        ///< rotation about z from the axes in the files to relidar's axes
    /// Beams from the data sheet, for files without ring numbers. Each point gets the
    /// ring of the beam with the nearest elevation, after the angles were fitted to the
    /// points. Points of another LiDAR are read without rings.
    std::vector<Beam> beams = {};
    /// Function that adds values which the files do not contain, such as rings and times.
    /// Several threads can call it at the same time. May be empty.
    /// @param where  name of the file, for error messages
    std::function<void(PointTable&, const std::string& where)> complete = {};
};
/// Reads the scans of all frames. Fits the beams of the sensor to the points.
/// @param scan_files  [frames] scan file of each frame
void read_frame_scans(Log& log, const std::vector<std::filesystem::path>& scan_files, FileFormat format,
                      const DatasetOptions& options);

/// Estimates from some of the files which intensity becomes 1. Sets it in the format.
/// Skips unreadable files.
void set_intensity_max(FileFormat& format, Log& log, const std::vector<std::filesystem::path>& scan_files);

}  // namespace relidar::read
