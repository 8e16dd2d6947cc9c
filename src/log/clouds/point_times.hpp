// SPDX-License-Identifier: Apache-2.0
// Finds and repairs point times that a driver or a file format has damaged.
#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include <relidar/log/points.hpp>

#include "log/clouds/point_table.hpp"

namespace relidar::folder {

/// Returns the first and the last time of a cloud, in the unit of the file. Ignores a few
/// times that are far from the others. Returns nothing if the points have no times.
std::optional<std::array<double, 2>> find_time_range(const PointTable& table);

/// Makes the times of a cloud continuous if their counter overflows in this cloud.
/// Subtracts the period of the counter from the times before the overflow.
/// @param are_offsets  true: times are relative to the scan, so they have no period of a
/// clock, such as a second or a day
void unwrap_point_times(PointTable& table, bool are_offsets);

/// Makes offsets negative if the file stores small negative offsets of all points of a
/// cloud as large unsigned numbers.
void restore_negative_offsets(PointTable& table);

/// Returns the distance between neighbouring values that the times of a cloud can have,
/// in the unit of the file. Detects numbers that were once 32-bit floats, and whole
/// seconds since 1970. Returns 0 for other numbers.
double find_time_resolution(const PointTable& table);
/// Returns true if the resolution is too coarse for times that span `span`.
inline bool is_coarse_time(double resolution, double span) {
    constexpr double kFineStep = 1e-4;  // precise, even if the unit is seconds
    return resolution > kFineStep && resolution > 0.05 * span;
}
/// Returns a note that times are ignored, because they have lost their precision.
std::string describe_coarse_times(double time, double resolution);

/// Returns a note if times decrease from point to point while the azimuths show a
/// clockwise sensor. Otherwise returns an empty text.
std::string describe_reversed_times(const PointTable& table);

/// Returns the time between the first and the last point, without the outermost tenths of
/// the points, extrapolated to all points.
double estimate_sweep_span_s(const LidarPoints& points);

/// Returns a note if the points of a scan were measured in a time that does not fit the
/// time between scans. The usual cause is a wrong unit of the times.
std::string describe_implausible_times(const std::vector<LidarPoints>& scans, double frame_step_s);

/// Share of the scans of a log that must agree before a scan with other times is skipped.
inline constexpr double kMostScans = 0.8;

/// Returns the median of the median times of scans. Returns nothing if too few of these
/// times are within `limit_s` of it.
std::optional<double> find_middle_time_s(const std::vector<LidarPoints>& scans, double limit_s);

/// Removes points whose times differ by more than `limit_s` from `middle_s`, or from the
/// median time if it is not given.
/// @return number of removed points
std::size_t remove_points_of_wrong_time(LidarPoints& points, double limit_s,
                                        std::optional<double> middle_s = std::nullopt);

}  // namespace relidar::folder
