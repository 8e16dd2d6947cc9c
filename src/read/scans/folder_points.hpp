// SPDX-License-Identifier: Apache-2.0
// Converts a table of points to the points of a scan. Also declares the interface that
// provides the scans of a log.
#pragma once

#include <string>

#include <relidar/base/error.hpp>
#include <relidar/read/clouds.hpp>

#include "read/files/point_table.hpp"
#include "read/scans/folder_head.hpp"

namespace relidar::read {

struct MostTimesWrong : DataError {
    using DataError::DataError;
};

/// Converts a table of points to the points of a scan. Finds the meaning of each field by
/// its name. Omits rays without a return: invalid points, and points at units.no_return.
/// @param frame_time_s  time that is subtracted from absolute point times
/// @throws DataError with the number of the invalid point
LidarPoints convert_table(const PointTable& table, const PointFileUnits& units, double frame_time_s,
                          const std::string& where);

/// Estimates the units that are not known, from the points of some scans. If several
/// intensity scales are possible, sets none. Intensities above 1 are then an error.
/// @param declared_by  what says the known units
void fill_units(PointFileUnits& units, const std::vector<std::filesystem::path>& scan_files,
                const std::string& declared_by, const Conventions& set, Log& log);

/// Scan of each frame, from files or messages. Several threads can call the functions.
class ScanProvider {
public:
    virtual ~ScanProvider() = default;
    virtual std::string frame_name(std::size_t frame) const = 0;  ///< name for error messages
    virtual bool stores_points(std::size_t) const { return true; }
    virtual LidarPoints read_points(std::size_t frame) const = 0;
    /// Called for frames that do not store points.
    virtual Scan read_rays(std::size_t) const { return {}; }
};

/// Sets what the user knows about the points. Lists these conventions.
void apply_conventions(Log& log, ScanLayout& layout, const Conventions& set);

/// Reads the scans of all frames. Poses must be set before, unless dataset.poses=none.
/// First plans from some scans how the points of each LiDAR become rays. Scans that
/// cannot be read are errors, or are removed from the log with options.skip_broken.
void read_scans(Log& log, const ScanLayout& layout, const ScanProvider& scan_provider,
                const DatasetOptions& options);

}  // namespace relidar::read
