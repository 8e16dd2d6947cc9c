// SPDX-License-Identifier: Apache-2.0
// Sensors for readers and writers of files: their JSON object, and of the built-in ones
// the maker's numbers of the beams and when each fires.
#pragma once

#include <string>
#include <vector>

#include <relidar/log/sensor.hpp>

namespace relidar {

class JsonField;

/// Reads a sensor: {"<kind>": {...}} with a kind of src/log/sensor/pattern_kinds.cpp. All
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
    int channel = 0;         ///< by the maker's count
    double offset_us = 0.0;  ///< from the first beam of a firing cycle
};

/// Of each beam of a built-in sensor that has a table (src/log/sensor/tables), the
/// highest first as in known_sensor().
/// @param name  one of sensor_names() that has a table
std::vector<BeamFiring> known_firings(const std::string& name);

}  // namespace relidar
