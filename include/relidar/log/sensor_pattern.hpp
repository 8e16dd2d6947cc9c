// SPDX-License-Identifier: Apache-2.0
// Sensors for readers and writers of files: their JSON object, and of the built-in ones
// the maker's numbers of the beams and when each fires.
#pragma once

#include <string>
#include <vector>

#include <relidar/log/sensor.hpp>

namespace relidar {

class JsonField;

/// Reads a sensor: {"<kind>": {...}} with a kind of describe_pattern_kinds(). All
/// files that hold sensors use this object. The maximum range is infinite where the file
/// gives none.
/// @param name  of the sensor if the file gives none
/// @throws DataError naming the member that is wrong
SensorModel read_sensor_json(const JsonField& field, const std::string& name);
/// Text of that object. It reads back to a sensor with the same rays, bit by bit.
std::string write_sensor_json(const SensorModel& sensor);

/// The kinds of that object and their members, a line for each.
std::string describe_pattern_kinds();

/// A line of a beam table.
struct BeamFiring {
    int channel = 0;         ///< channel number of the manufacturer
    double offset_us = 0.0;  ///< time since the first beam of the firing cycle
};

/// Returns the firing data of each beam of a built-in sensor, highest beam first like
/// known_sensor(). The data are in src/log/sensor/tables.
/// @param name  a name of sensor_names() that has a table
std::vector<BeamFiring> known_firings(const std::string& name);

}  // namespace relidar
