// SPDX-License-Identifier: Apache-2.0
// Estimates the units of a topic's point values from some of its clouds, because messages
// do not state the units.
#pragma once

#include <string>
#include <vector>

#include "log/clouds/point_meaning.hpp"

namespace relidar::bag {

/// The time at which the points' times are zero.
enum class TimeZero {
    none,   ///< the points have no usable times
    stamp,  ///< offsets from the cloud's stamp
    epoch,  ///< times on the clock of the stamps
    /// times on another clock; the first point time of a cloud is assumed to be the
    /// cloud's stamp
    sensor_clock
};

struct CloudUnits {
    TimeZero zero = TimeZero::none;
    double time_unit_s = 1.0;
    /// true: all points of a cloud have the same time, so the cloud is motion-compensated
    bool is_deskewed = false;
    folder::PointMeaning meaning;
    std::string about;  ///< description of the times for the log's notes
};

/// Estimates the units of the point values.
/// @param clouds  some clouds of the topic
/// @param stamps_s  [clouds] stamp of each cloud in seconds
/// @param step_s  time between clouds in seconds
CloudUnits find_units(const std::vector<folder::PointTable>& clouds, const std::vector<double>& stamps_s,
                      double step_s);

}  // namespace relidar::bag
