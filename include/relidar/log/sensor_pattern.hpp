// SPDX-License-Identifier: Apache-2.0
// Data of the built-in sensors for decoding their packets: the manufacturer's channel
// numbers and the firing time of each beam.
#pragma once

#include <string>
#include <vector>

#include <relidar/log/sensor.hpp>

namespace relidar {

/// Firing data of a beam.
struct BeamFiring {
    int channel = 0;         ///< channel number of the manufacturer
    double offset_us = 0.0;  ///< time since the first beam of the firing cycle
};

/// Returns the firing data of each beam of a built-in sensor, highest beam first like
/// known_sensor(). The data are in src/log/sensor/tables.
/// @param name  a name of sensor_names() that has a table
std::vector<BeamFiring> known_firings(const std::string& name);

}  // namespace relidar
