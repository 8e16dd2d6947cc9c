// SPDX-License-Identifier: Apache-2.0
// Converts a table of points to the points of a scan, and defines the source of a log's
// scans.
#pragma once

#include <string>

#include <relidar/log/clouds.hpp>

#include "log/clouds/folder_head.hpp"
#include "log/clouds/point_table.hpp"

namespace relidar::folder {

/// Converts a table of points by the meaning of its fields (value_of_field()). With
/// Nebula's return_type, points with the same ring, time and direction become returns of
/// one ray. A point with a NaN as x, or at the origin, is a ray without a return.
/// @param time_s  subtracted from absolute times
/// @throws DataError with the number of the invalid point
Points points_of(const PointTable& table, const PointUnits& units, double time_s, const std::string& where);

/// Source of the scans of a log's frames: files of a folder, or messages of a recording.
/// All functions can be called from any thread.
class ScanSource {
public:
    virtual ~ScanSource() = default;
    virtual std::string name(std::size_t frame) const = 0;  ///< name for error messages
    /// true: the frame has points; false: it has rays
    virtual bool has_points(std::size_t frame) const = 0;
    virtual Points points(std::size_t frame) const = 0;
    virtual Scan rays(std::size_t frame) const = 0;
};

/// Reads the scans of sequence.frames, whose poses are set, and completes the sensors of
/// LiDARs whose beams are estimated from the points. Without poses (options.poses_file is
/// kNoPoses), motion compensation cannot be undone.
void read_scans(Sequence& sequence, const Head& head, const ScanSource& source,
                const DatasetOptions& options);

}  // namespace relidar::folder
