// SPDX-License-Identifier: Apache-2.0
// Converts a table of points to the points of a scan. Also declares the interface from
// which the scans of a log are read.
#pragma once

#include <string>

#include <relidar/log/clouds.hpp>

#include "log/clouds/folder_head.hpp"
#include "log/clouds/point_table.hpp"

namespace relidar::folder {

/// Converts a table of points to relidar's units. Finds the meaning of each field by its
/// name (see find_value_of_field()). If the table has Nebula's field return_type, points
/// with the same ring, time and direction become returns of one ray. Omits rays without a
/// return: points that is_return() rejects, and points at the position units.no_return.
/// @param time_s  time that is subtracted from absolute point times
/// @throws DataError with the number of the invalid point
Points make_points(const PointTable& table, const PointUnits& units, double time_s,
                   const std::string& location);

/// Provides the scan of each frame, from files of a folder or from messages of a bag.
/// Several threads can call the functions at the same time.
class ScanSource {
public:
    virtual ~ScanSource() = default;
    virtual std::string name(std::size_t frame) const = 0;  ///< name for error messages
    /// Returns true if the scan of the frame is stored as points, false if it is stored
    /// as rays.
    virtual bool has_points(std::size_t frame) const = 0;
    virtual Points points(std::size_t frame) const = 0;
    virtual Scan rays(std::size_t frame) const = 0;
};

/// Reads the scans of all frames, which must already have poses. Estimates unknown beams
/// from the points. Undoes motion compensation only if the log has poses
/// (options.poses_file is not kNoPoses).
void read_scans(Sequence& sequence, const Head& head, const ScanSource& source,
                const DatasetOptions& options);

}  // namespace relidar::folder
