// SPDX-License-Identifier: Apache-2.0
// Logs whose scans are files named by their times, and whose poses have times of their
// own: what Boreas, MulRan and ONCE have in common.
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
    int number = 0;          ///< of its frame
    std::int64_t stamp = 0;  ///< as the dataset counts time
    std::filesystem::path file;
};
/// A number of digits alone, as names of files and times in tables have it.
std::optional<std::int64_t> parse_stamp(std::string_view text);
/// Files STAMP.bin of a folder in the order of time, numbered from 0. @throws DataError
/// where there is none
std::vector<StampedScan> list_scans(const std::filesystem::path& folder);

/// A line of a table of poses.
struct StampedRow {
    std::int64_t stamp = 0;
    std::vector<double> values;  ///< those after the stamp, all finite
    std::string where;           ///< file and line, for messages
};
/// Lines of a stamp and numbers, parted by commas; a first line of words is passed over.
/// Of two lines with one stamp the first counts.
/// @param n_values  of each line, or more @throws DataError naming file and line; where
/// stamps fall
std::vector<StampedRow> read_rows(const std::filesystem::path& file, std::size_t n_values);

/// Which way a vehicle drives as seen by what rides on it.
struct Driving {
    /// direction of its steps, of length 1 where that never changes; 0 where it stands
    glm::dvec3 mean{0.0};
    double rise_spread = 0.0;  ///< standard deviation of their z
    std::size_t n_steps = 0;   ///< of a metre and more
};
Driving find_driving(const PoseTrack& world_from_rider);
/// A note where poses do not drive the way the vehicle looks. @param forward  share of
/// Driving::mean along that way
void tell_unless_forward(std::vector<std::string>& notes, double forward);

/// What a reader knows before it reads scans.
struct StampedLog {
    double unit_s = 1.0;               ///< of stamps
    std::vector<StampedScan> scans;    ///< all of the log; the first is at 0 s
    PoseTrack world_from_vehicle;      ///< at times of its own
    std::filesystem::path poses_file;  ///< which has them
    double most_gap_s = 0.0;           ///< between two poses that may be interpolated
    double reach_s = 0.0;              ///< how long before and after its time a scan needs poses

    double seconds(std::int64_t stamp) const { return double(stamp - scans[0].stamp) * unit_s; }
};
/// Adds the scans of the asked range as frames, with their poses or those of
/// DatasetOptions::poses_file, and recentres. Scans without a pose are left out with a
/// note.
/// @return their files @throws UsageError where the range has no scan, DataError where
/// none of its scans has a pose
std::vector<std::filesystem::path> add_frames(Sequence& sequence, const StampedLog& log,
                                              const DatasetOptions& options);

/// @throws DataError where nobody gives poses: neither this file nor the options
void check_poses(const std::filesystem::path& file, const DatasetOptions& options);

/// How files hold points of one LiDAR.
struct PointFormat {
    folder::PointUnits units;
    double turn_s = 0.1;      ///< how long a sweep takes, where points have no times
    double turned_rad = 0.0;  ///< about z: from the axes of the files to relidar's
    /// Nominal, where files have no rings: a point is of the beam that passes nearest.
    /// Their elevations, and their azimuths within a step of the head, are fitted to the
    /// points; by how many whole steps they differ is not seen in points without times.
    /// Where points are those of another LiDAR, beams are found from elevations alone.
    std::vector<Beam> beams = {};
    /// Adds what files do not say themselves. From any thread; may be empty. @param where
    /// file, for messages
    std::function<void(folder::PointTable&, const std::string& where)> complete = {};
};
/// Reads the scans of all frames, and fits the sensor to them. @param files  [frames]
void read_points(Sequence& sequence, const std::vector<std::filesystem::path>& files, PointFormat format,
                 const DatasetOptions& options);

/// What counts as 1 where no document says how bright points are: 1 or 255 where none is
/// brighter, else what few are brighter than.
struct Brightness {
    double most = 1.0;
    std::string about;  ///< in words, where something was cut
};
/// @param files  of the scans; a few are looked at, what cannot be read is told later
Brightness find_brightness(const std::vector<std::filesystem::path>& files,
                           const std::vector<std::string>& columns);

}  // namespace relidar::stamped
