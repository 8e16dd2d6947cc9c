// SPDX-License-Identifier: Apache-2.0
// What numbers of a topic's points mean, as some of its clouds show it: drivers do not
// say.
#pragma once

#include <string>
#include <vector>

#include "log/clouds/folder_head.hpp"
#include "log/readers/bag/survey.hpp"

namespace relidar::bag {

/// What times of points count from.
enum class TimeZero {
    none,      ///< there are no times that can be used
    stamp,     ///< offsets from the cloud's stamp
    epoch,     ///< times of the clock of the stamps
    own_clock  ///< times of another clock: the cloud's first is taken for its stamp
};

struct CloudUnits {
    TimeZero zero = TimeZero::none;
    double time_unit_s = 1.0;
    bool is_deskewed = false;  ///< all points of a cloud have one time
    double intensity_max = 1.0;
    std::string about;  ///< in words
};

/// @param clouds  a few of the topic's, with their stamps @param step_s  from one cloud
/// to the next
CloudUnits find_units(const std::vector<folder::PointTable>& clouds, const std::vector<double>& stamps_s,
                      double step_s);

}  // namespace relidar::bag
