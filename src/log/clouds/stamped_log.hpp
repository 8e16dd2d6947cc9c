// SPDX-License-Identifier: Apache-2.0
// Logs whose scan files are named by their times and whose poses have separate times.
// Boreas, MulRan and ONCE use it.
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

/// A scan of the log.
struct StampedScan {
    int number = 0;          ///< number of the scan's frame
    std::int64_t stamp = 0;  ///< time in the unit of the dataset
    std::filesystem::path file;
};
/// Parses a stamp that consists of digits only, as in file names and tables.
std::optional<std::int64_t> parse_stamp(std::string_view text);
/// Lists the files STAMP.bin of a folder in order of time, numbered from 0.
/// @throws DataError if there is none
std::vector<StampedScan> list_scans(const std::filesystem::path& folder);

/// A line of a table of poses.
struct StampedRow {
    std::int64_t stamp = 0;
    std::vector<double> values;  ///< the finite values after the stamp
    std::string where;           ///< file and line for error messages
};
/// Reads lines of a stamp and numbers, separated by commas. Skips a first line of column
/// names. Of two lines with the same stamp, uses the first.
/// @param n_values  minimum number of values per line
/// @throws DataError with file and line; also if stamps decrease
std::vector<StampedRow> read_rows(const std::filesystem::path& file, std::size_t n_values);

/// Driving direction of a vehicle in the frame of a mounted sensor.
struct Driving {
    /// Mean direction of its steps. Length 1 if the direction never changes, 0 if the
    /// vehicle does not move.
    glm::dvec3 mean{0.0};
    double rise_spread = 0.0;  ///< standard deviation of the steps' z
    std::size_t n_steps = 0;   ///< number of steps of at least one metre
};
Driving find_driving(const PoseTrack& world_from_rider);
/// Adds a note if the poses do not move in the vehicle's forward direction.
/// @param forward  component of Driving::mean in the forward direction
void tell_unless_forward(std::vector<std::string>& notes, double forward);

/// Data that a reader has before it reads scans.
struct StampedLog {
    double unit_s = 1.0;               ///< unit of stamps
    std::vector<StampedScan> scans;    ///< all scans of the log; the first is at 0 s
    PoseTrack world_from_vehicle;      ///< poses with separate times
    std::filesystem::path poses_file;  ///< file of the poses
    double most_gap_s = 0.0;           ///< maximum gap between poses for interpolation
    double reach_s = 0.0;              ///< a scan needs poses this long before and after its time

    double seconds(std::int64_t stamp) const { return double(stamp - scans[0].stamp) * unit_s; }
};
/// Adds the scans of the requested range as frames, with their poses or those of
/// DatasetOptions::poses_file, and recentres the log. Skips scans without a pose, with a
/// note.
/// @return files of the scans
/// @throws UsageError if the range has no scan, DataError if none of its scans has a pose
std::vector<std::filesystem::path> add_frames(Sequence& sequence, const StampedLog& log,
                                              const DatasetOptions& options);

/// Checks that poses exist.
/// @throws DataError if neither this file nor the options provide poses
void check_poses(const std::filesystem::path& file, const DatasetOptions& options);

/// Format of the point files of a LiDAR.
struct PointFormat {
    folder::PointUnits units;
    double turn_s = 0.1;      ///< duration of a sweep, if points have no times
    double turned_rad = 0.0;  ///< rotation about z from the axes of the files to relidar's axes
    /// Nominal beams, if files have no rings: a point belongs to the nearest beam.
    /// Elevations are fitted to the points, and azimuths are fitted within a step of the
    /// head. Points without times do not show differences of whole steps. If the points
    /// come from another LiDAR, beams are estimated from elevations only.
    std::vector<Beam> beams = {};
    /// Adds values that the files do not contain. Called from any thread; may be empty.
    /// @param where  file for error messages
    std::function<void(folder::PointTable&, const std::string& where)> complete = {};
};
/// Reads the scans of all frames and fits the sensor to them.
/// @param files  [frames]
void read_points(Sequence& sequence, const std::vector<std::filesystem::path>& files, PointFormat format,
                 const DatasetOptions& options);

/// Intensity that counts as 1, for datasets without documentation: 1 or 255 if no
/// intensity is larger, otherwise a value that few intensities exceed.
struct Brightness {
    double most = 1.0;
    std::string about;  ///< description, if intensities are clamped
};
/// Determines the brightness.
/// @param files  scan files; only some are read, and unreadable files are reported later
Brightness find_brightness(const std::vector<std::filesystem::path>& files,
                           const std::vector<std::string>& columns);

}  // namespace relidar::stamped
