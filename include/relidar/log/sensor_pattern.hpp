// SPDX-License-Identifier: Apache-2.0
// Of the built-in sensors, what readers of their packets need: the maker's numbers of the
// beams, and when each fires.
#pragma once

#include <string>
#include <vector>

#include <relidar/log/sensor.hpp>

namespace relidar {

/// A line of a beam table.
struct BeamFiring {
    int channel = 0;         ///< by the maker's count
    double offset_us = 0.0;  ///< from the first beam of a firing cycle
};

/// Of each beam of a built-in sensor that has a table (src/log/sensor/tables), the
/// highest first as in known_sensor().
/// @param name  one of sensor_names() that has a table
std::vector<BeamFiring> known_firings(const std::string& name);

}  // namespace relidar
