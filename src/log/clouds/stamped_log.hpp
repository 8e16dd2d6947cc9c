// SPDX-License-Identifier: Apache-2.0
// Reads logs whose scan files are named by their timestamps and whose poses have other
// timestamps. Used for Boreas, MulRan and ONCE.
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

/// A scan file of the log with its timestamp.
struct StampedScan {
    int number = 0;          ///< number of the scan's frame
    std::int64_t stamp = 0;  ///< time in the unit of the dataset
    std::filesystem::path file;
};
/// Parses a timestamp that has only digits. Timestamps in file names and tables have this
/// form.
std::optional<std::int64_t> parse_stamp(std::string_view text);
/// Lists the files STAMP.bin of a folder in order of time. The scans are numbered from 0.
/// @throws DataError if the folder has no such file
std::vector<StampedScan> list_scans(const std::filesystem::path& folder);

/// One line of a pose table.
struct StampedRow {
    std::int64_t stamp = 0;
    std::vector<double> values;  ///< the finite values after the stamp
    std::string where;           ///< file and line for error messages
};
/// Reads a table of comma-separated lines, each with a timestamp and numbers. A first
/// line of column names is skipped. If two lines have the same timestamp, the first one
/// is used.
/// @param n_values  minimum number of values per line
/// @throws DataError with file and line, also if timestamps decrease
std::vector<StampedRow> read_rows(const std::filesystem::path& file, std::size_t n_values);

/// Driving direction of a vehicle, in the frame of a sensor that is mounted on it.
struct Driving {
    /// Mean of the unit vectors between consecutive positions. Its length is 1 if the
    /// direction never changes, and 0 if the vehicle does not move.
    glm::dvec3 mean{0.0};
    double rise_spread = 0.0;  ///< standard deviation of the z component of these unit vectors
    std::size_t n_steps = 0;   ///< number of steps of at least one metre
};
Driving find_driving(const PoseTrack& world_from_rider);
/// Adds a note to the log if the vehicle seems not to drive in its forward direction.
/// @param forward  component of Driving::mean in the forward direction
void warn_unless_forward(std::vector<std::string>& notes, double forward);

/// Scans and poses of a log, which are known before any scan is read.
struct StampedLog {
    double unit_s = 1.0;               ///< unit of the timestamps in seconds
    std::vector<StampedScan> scans;    ///< all scans of the log; the first is at 0 s
    PoseTrack world_from_vehicle;      ///< poses with separate times
    std::filesystem::path poses_file;  ///< file of the poses
    double most_gap_s = 0.0;           ///< poses with a larger time difference are not interpolated
    double reach_s = 0.0;              ///< poses must exist for this time before and after a scan

    double seconds(std::int64_t stamp) const { return double(stamp - scans[0].stamp) * unit_s; }
};
/// Adds the scans of the requested range to the log as frames and recentres the log. The
/// poses are those of the dataset or of DatasetOptions::poses_file. Scans without a pose
/// are skipped with a note.
/// @return files of the scans
/// @throws UsageError if the range has no scan
/// @throws DataError if none of its scans has a pose
std::vector<std::filesystem::path> add_frames(Sequence& sequence, const StampedLog& log,
                                              const DatasetOptions& options);

/// Checks that the pose file exists, or that the options give another source of poses.
/// @throws DataError if there are no poses
void check_poses(const std::filesystem::path& file, const DatasetOptions& options);

/// Format of the point files of a LiDAR.
struct PointFormat {
    folder::PointUnits units;
    double turn_s = 0.1;      ///< duration of a sweep in seconds, used if points have no times
    double turned_rad = 0.0;  ///< rotation about z from the axes of the files to relidar's axes
    /// Nominal beams of the LiDAR, used if the files have no rings. Each point then
    /// belongs to the nearest beam. The elevations are fitted to the points. The azimuth
    /// offsets are fitted too, but only within one azimuth step, because points without
    /// times do not show more. If the points come from another LiDAR, all beams are
    /// estimated from the elevations.
    std::vector<Beam> beams = {};
    /// Computes values of the points that the files lack, such as rings and times. Any
    /// thread can call it. May be empty.
    /// @param where  file for error messages
    std::function<void(folder::PointTable&, const std::string& where)> complete = {};
};
/// Reads the scans of all frames and fits the beams of the sensor to their points.
/// @param files  [frames] scan file of each frame
void read_points(Sequence& sequence, const std::vector<std::filesystem::path>& files, PointFormat format,
                 const DatasetOptions& options);

/// Intensity that is scaled to 1, for datasets that do not document it. It is 1 or 255 if
/// no intensity is larger. Otherwise it is a value that only few intensities exceed.
struct Brightness {
    double most = 1.0;
    std::string about;  ///< description for a note if larger intensities are clamped to 1
};
/// Determines which intensity is scaled to 1.
/// @param files  scan files. Only some are read. Files that cannot be read are skipped,
/// because reading the scans reports the error.
Brightness find_brightness(const std::vector<std::filesystem::path>& files,
                           const std::vector<std::string>& columns);

}  // namespace relidar::stamped
