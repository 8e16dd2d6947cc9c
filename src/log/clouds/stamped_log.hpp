// SPDX-License-Identifier: Apache-2.0
// Reads logs whose scan files are named by time stamps. The poses have other time stamps.
// Used for Boreas, MulRan and ONCE.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <relidar/log/dataset.hpp>

#include "log/clouds/folder_head.hpp"
#include "log/clouds/point_table.hpp"

namespace relidar::stamped {

/// A scan file of the log and its time stamp.
struct StampedScan {
    int number = 0;          ///< number of the scan's frame
    std::int64_t stamp = 0;  ///< time of the scan in the unit of the dataset
    std::filesystem::path file;
};
/// Parses a time stamp that consists of digits only, such as in file names. Returns
/// nothing for other texts.
std::optional<std::int64_t> parse_stamp(std::string_view text);
/// Lists the files STAMP.bin in a folder, sorted by time. Numbers the scans from 0.
/// @throws DataError if the folder contains no such file
std::vector<StampedScan> list_scans(const std::filesystem::path& folder);

/// One line of a table of poses.
struct StampedRow {
    std::int64_t stamp = 0;
    std::vector<double> values;  ///< the numbers after the time stamp; all are finite
    std::string where;           ///< name of the file and line number, for error messages
};
/// Reads a table of comma-separated lines. Each line contains a time stamp and numbers.
/// Skips a first line with column names. If two lines have the same time stamp, uses the
/// first line.
/// @param n_values  minimum number of values per line
/// @throws DataError with file and line, also if time stamps decrease
std::vector<StampedRow> read_rows(const std::filesystem::path& file, std::size_t n_values);

/// Driving direction of a vehicle, in the frame of a sensor on the vehicle.
struct Driving {
    /// Mean of the unit vectors from each position to the next. The length is 1 if the
    /// direction never changes, and 0 if the vehicle does not move.
    glm::dvec3 mean{0.0};
    double rise_spread = 0.0;  ///< standard deviation of the z components of the unit vectors
    std::size_t n_steps = 0;   ///< number of position changes of at least one metre
};
Driving find_driving(const PoseTrack& world_from_rider);
/// Adds a warning to the notes if the vehicle does not seem to drive forward.
/// @param forward  component of Driving::mean in the forward direction
void warn_unless_forward(std::vector<std::string>& notes, double forward);

/// List of a log's scan files with their time stamps, and the log's poses. The points of
/// the scans are read later.
struct StampedLog {
    double unit_s = 1.0;               ///< unit of the time stamps in seconds
    std::vector<StampedScan> scans;    ///< all scans of the log; the time of the first scan is 0 s
    PoseTrack world_from_vehicle;      ///< poses with separate times
    std::filesystem::path poses_file;  ///< file of the poses
    /// Poses are not interpolated if the time between them is larger than this.
    double most_gap_s = 0.0;
    /// A scan is used only if poses exist for this time before and after the scan.
    double reach_s = 0.0;

    double seconds(std::int64_t stamp) const { return double(stamp - scans[0].stamp) * unit_s; }
};
/// Adds the scans of the requested range to the log as frames. Moves the origin of the
/// world to the log. The poses are read from the dataset or from
/// DatasetOptions::poses_file. Skips scans without a pose and adds a note.
/// @return files of the scans
/// @throws UsageError if the range contains no scan
/// @throws DataError if no scan in the range has a pose
std::vector<std::filesystem::path> add_frames(Sequence& sequence, const StampedLog& log,
                                              const DatasetOptions& options);

/// Checks that the pose file exists, or that the options name another source of poses.
/// @throws DataError if there are no poses
void check_poses(const std::filesystem::path& file, const DatasetOptions& options);

/// Format of the files that contain the points of a LiDAR.
struct PointFormat {
    folder::PointUnits units;
    double turn_s = 0.1;      ///< duration of a sweep in seconds; used if the points have no times
    double turned_rad = 0.0;  ///< rotation about z from the axes in the files to relidar's axes
    /// Nominal beams of the LiDAR, used if the files contain no rings. Each point is
    /// assigned to the nearest beam. Elevations and azimuth offsets are fitted to the
    /// points. Azimuth offsets are fitted only within one azimuth step, because points
    /// without times do not show more. If the points come from another LiDAR, all beams
    /// are estimated from the elevations.
    std::vector<Beam> beams = {};
    /// Callback that computes values which the files do not contain, such as rings and
    /// times. Several threads can call it at the same time. May be empty.
    /// @param where  name of the file, for error messages
    std::function<void(folder::PointTable&, const std::string& where)> complete = {};
};
/// Reads the scans of all frames. Fits the beams of the sensor to the points.
/// @param files  [frames] scan file of each frame
void read_points(Sequence& sequence, const std::vector<std::filesystem::path>& files, PointFormat format,
                 const DatasetOptions& options);

/// Intensity that is scaled to 1, for datasets that do not document it. If all
/// intensities are at most 1, the value is 1. If all are at most 255, it is 255.
/// Otherwise only few intensities exceed the value.
struct Brightness {
    double most = 1.0;
    std::string about;  ///< text for a note, used if larger intensities are clamped to 1
};
/// Estimates the intensity that is scaled to 1.
/// @param files  scan files. Only some of them are read. Files that cannot be read are
/// skipped, because the error is reported when the scans are read.
Brightness find_brightness(const std::vector<std::filesystem::path>& files,
                           const std::vector<std::string>& columns);

}  // namespace relidar::stamped
