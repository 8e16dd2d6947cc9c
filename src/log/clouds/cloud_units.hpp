// SPDX-License-Identifier: Apache-2.0
// Estimates the units of the point values of a topic, because messages do not contain the
// units. Uses some clouds of the topic.
#pragma once

#include <string>
#include <vector>

#include "log/clouds/point_meaning.hpp"

namespace relidar::bag {

/// The moment at which the time field of a point is 0.
enum class TimeZero {
    none,   ///< unknown, because the points have no usable times
    stamp,  ///< offsets from the cloud's stamp
    epoch,  ///< zero of the clock that also gives the message stamps
    /// zero of another clock; the first point of each cloud is assumed to be measured at
    /// the message stamp
    sensor_clock
};

struct CloudUnits {
    TimeZero zero = TimeZero::none;
    double time_unit_s = 1.0;
    /// True if all points of a cloud have the same time, because the cloud was
    /// motion-compensated.
    bool is_deskewed = false;
    folder::PointMeaning meaning;
    std::string about;  ///< text about the point times for the notes of the log
};

/// Estimates the units of the point values from some clouds.
/// @param clouds  some clouds of the topic
/// @param stamps_s  [clouds] time stamp of each cloud in seconds
/// @param step_s  time between clouds in seconds
CloudUnits find_units(const std::vector<folder::PointTable>& clouds, const std::vector<double>& stamps_s,
                      double step_s);

}  // namespace relidar::bag
