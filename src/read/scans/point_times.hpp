// SPDX-License-Identifier: Apache-2.0
// Finds and repairs point times that a driver or a file format has damaged.
#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include <relidar/read/points.hpp>

#include "read/files/point_table.hpp"

namespace relidar::read {

/// Returns the first and the last time of a cloud, in the unit of the file, without
/// outliers. Returns nothing if the cloud has no finite time.
std::optional<std::array<double, 2>> find_time_range(const PointTable& table);

/// Makes the times of a cloud continuous if their counter overflows in this cloud.
/// Subtracts the period of the counter from the times before the overflow.
/// @param are_offsets  true: times are relative to the scan, so they have no period of a
/// clock, such as a second or a day
void unwrap_times(PointTable& table, bool are_offsets);

/// Makes offsets negative if all are small, and stored as large unsigned numbers.
void restore_signs(PointTable& table);

/// Returns the distance between neighbouring values that the times of a cloud can have,
/// in the unit of the file. Detects numbers that were 32-bit floats before, and whole
/// seconds since 1970. Returns 0 for other numbers.
double time_resolution(const PointTable& table);
/// Returns true if steps of `resolution` cannot order the points of a scan of `span`.
inline bool is_coarse_time(double resolution, double span) {
    constexpr double kFineStep = 1e-4;  // precise, even if the unit is seconds
    return resolution > kFineStep && resolution > 0.05 * span;
}
/// Returns a note that times are ignored, because they have lost their precision.
std::string describe_coarse(double time, double resolution);

/// Returns the time from the first to the last point, without the outermost tenths of the
/// points, extrapolated to all points.
double sweep_span_s(const LidarPoints& points);

/// Returns a note if the duration of scans does not fit the time between them, usually
/// because of a wrong unit, or if the points are too far from the time of their scan.
std::string describe_span(const std::vector<LidarPoints>& scans, double frame_step_s);

/// Share of the scans that must agree before a scan with other times is skipped.
inline constexpr double kMinScanShare = 0.8;

/// Returns the usual time of the points of a scan, relative to its frame: the median of
/// the scans' medians. Returns nothing if too many of these differ by over `limit_s`.
std::optional<double> middle_time_s(const std::vector<LidarPoints>& scans, double limit_s);

/// Keeps only the points with the given indices, in this order.
void select_points(LidarPoints& points, const std::vector<std::size_t>& indices);

/// Removes points farther than `limit_s` from `middle_s`, or from the median time.
/// @return number of removed points
std::size_t remove_mistimed(LidarPoints& points, double limit_s,
                            std::optional<double> middle_s = std::nullopt);

}  // namespace relidar::read
