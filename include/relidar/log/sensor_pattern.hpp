// SPDX-License-Identifier: Apache-2.0
// Reads and writes sensors as JSON objects. Also returns the channel numbers and the
// firing times of the beams of built-in sensors.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/log/sensor.hpp>

namespace relidar {

class JsonField;

/// Reads a sensor from a JSON object {"<kind>": {...}}. pattern_help() lists
/// the possible kinds. All files that contain sensors use such an object. If the object
/// has no maximum range, the maximum range is infinite.
/// @param default_name  name of the sensor if the object does not contain a name
/// @throws DataError naming the member that is wrong
SensorModel read_sensor_json(const JsonField& field, const std::string& default_name);
/// Returns the JSON text of a sensor. read_sensor_json() creates a sensor with exactly
/// the same rays from this text.
std::string format_sensor_json(const SensorModel& sensor);

/// Returns a text for users that lists the kinds of sensor objects and their members, one
/// line for each kind.
std::string pattern_help();

/// Channel number and firing time of one beam, from a line of a beam table.
struct BeamFiring {
    int channel = 0;         ///< channel number of the manufacturer
    double offset_us = 0.0;  ///< time since the first beam of the firing cycle
};

/// Returns the channel number and firing time of each beam of a built-in sensor, highest
/// beam first. The values are in src/log/sensor/tables.
/// @param name  a name of list_sensors() that has a table
std::vector<BeamFiring> read_firings(const std::string& name);

/// Returns the maximum range in the data sheet of a built-in sensor, or of a sensor of a
/// log that is "fitted to" this log. Empty for other sensors.
std::optional<double> nominal_max_range_m(const std::string& name);

}  // namespace relidar
