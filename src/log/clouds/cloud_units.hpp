// SPDX-License-Identifier: Apache-2.0
// Determines the units of a topic's point values from some of its clouds, because drivers
// do not publish them.
#pragma once

#include <string>
#include <vector>

#include "log/clouds/folder_head.hpp"
#include "log/readers/bag/survey.hpp"

namespace relidar::bag {

/// Zero of the points' times.
enum class TimeZero {
    none,      ///< the points have no usable times
    stamp,     ///< offsets from the cloud's stamp
    epoch,     ///< times on the clock of the stamps
    own_clock  ///< times on another clock; the first time of a cloud is equated with its stamp
};

struct CloudUnits {
    TimeZero zero = TimeZero::none;
    double time_unit_s = 1.0;
    bool is_deskewed = false;  ///< all points of a cloud have the same time
    double intensity_max = 1.0;
    std::string about;  ///< description of the units for the log's notes
};

/// Determines the units.
/// @param clouds  some clouds of the topic, with their stamps
/// @param step_s  time between clouds
CloudUnits find_units(const std::vector<folder::PointTable>& clouds, const std::vector<double>& stamps_s,
                      double step_s);

}  // namespace relidar::bag
