// SPDX-License-Identifier: Apache-2.0
// A table of points as points of a scan, and where the scans of a log come from.
#pragma once

#include <string>

#include <relidar/log/clouds.hpp>

#include "log/clouds/folder_head.hpp"
#include "log/clouds/point_table.hpp"

namespace relidar::folder {

/// Converts a table to points, by the values that its fields hold (value_of_field()). With
/// return_type of Nebula, returns of one ring, time and direction become returns of one
/// ray. A point whose x is no number, or which lies at the origin, is a ray without a
/// return.
/// @param time_s  what is taken off absolute times @throws DataError naming the point
ScanPoints points_of(const PointTable& table, const PointUnits& units, double time_s,
                     const std::string& where);

/// Where the scans of a log's frames come from: files of a folder, or messages of a
/// recording. All from any thread.
class ScanSource {
public:
    virtual ~ScanSource() = default;
    virtual std::string name(std::size_t frame) const = 0;  ///< for messages
    virtual bool has_points(std::size_t frame) const = 0;   ///< else it has rays
    virtual ScanPoints points(std::size_t frame) const = 0;
    virtual Scan rays(std::size_t frame) const = 0;
};

/// Reads the scans of sequence.frames, which has its poses, and completes the sensors of
/// LiDARs whose beams are found from the points. Without poses (options.poses_file is
/// kNoPoses) motion compensation cannot be undone.
void read_scans(Sequence& sequence, const Head& head, const ScanSource& source,
                const DatasetOptions& options);

}  // namespace relidar::folder
