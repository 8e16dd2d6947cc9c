// SPDX-License-Identifier: Apache-2.0
// Table of the kinds of sensors, such as "spinning" or "rays". Sensor files, rigs, logs
// and runs store a sensor as a JSON object with one member, {"<kind>": {...}}. Each kind
// has functions that read and write this member.
#pragma once

#include <initializer_list>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include <relidar/log/sensor.hpp>

#include "base/json_field.hpp"

namespace relidar {

/// A kind of sensor. The index of a kind is that of its struct in SensorPattern.
struct PatternKind {
    const char* name;     ///< key of the JSON object that describes the sensor
    const char* members;  ///< names of the members of the JSON object, for the command-line help
    /// @param name  used if the object contains none
    /// @throws DataError naming the member that is wrong
    SensorModel (*parse)(const JsonField& field, const std::string& name);
};

const std::vector<PatternKind>& all_pattern_kinds();
/// Returns the kind of sensor that a JSON object names, or null if it names none.
const PatternKind* find_kind(const JsonField& field);

namespace sensor {

/// In a log folder, a JSON object without a kind is a spinning sensor. In a sensor file,
/// an object with the member "directions" is a table of rays.
SensorModel parse_spinning(const JsonField& field, const std::string& default_name);
SensorModel parse_window(const JsonField& field, const std::string& default_name);
SensorModel parse_rosette(const JsonField& field, const std::string& default_name);
SensorModel parse_ray_table(const JsonField& field, const std::string& default_name);

/// Returns the JSON object without name and range limits. It reads back exactly.
nlohmann::ordered_json write(const SpinningSensor& sensor);
nlohmann::ordered_json write(const WindowScanSensor& window);
nlohmann::ordered_json write(const RosetteSensor& rosette);
nlohmann::ordered_json write(const RayTable& rays);

ScanPatternSummary describe(const SpinningSensor& sensor);
ScanPatternSummary describe(const WindowScanSensor& window);
ScanPatternSummary describe(const RosetteSensor& rosette);
ScanPatternSummary describe(const RayTable& rays);

/// Reads an angle from the JSON member NAME_rad in radians or NAME_deg in degrees.
/// @return radians
/// @throws DataError if both members are missing, or the angle is outside +-max_abs_deg
double read_angle_rad(const JsonField& field, const std::string& name, double max_abs_deg);
double read_angle_or_rad(const JsonField& field, const std::string& name, double default_rad,
                         double max_abs_deg);
double read_number_or(const JsonField& field, const char* key, double default_value, double min, double max);

/// Members of all kinds. A missing max_range_m means infinity.
struct CommonMembers {
    std::string name;
    RangeLimits limits;
    double period_s, divergence_rad;
};
/// Reads the members that all kinds of sensors can have.
/// @param min_s smallest allowed period
CommonMembers read_common(const JsonField& field, const std::string& default_name, double min_s = 1e-6);
/// Members of all sensors are allowed, too. An angle NAME is NAME_rad or NAME_deg.
/// @throws DataError for an unknown member
void check_members(const JsonField& field, std::vector<std::string> allowed_member_names,
                   const std::vector<std::string>& allowed_angle_names);

void add_ray(RayTable& rays, const glm::dvec3& direction, double time_s, int channel);
/// Checks the number of rays of a sensor.
/// @throws UsageError if the number is not in the range 1 to kMaxRays
void check_ray_count(const std::string& sensor_name, double n_rays);
/// Checks that the period of a pattern is positive and that its other values are finite.
/// @throws UsageError if a check fails
void check_pattern(const std::string& sensor_name, double period_s, std::initializer_list<double> values);

}  // namespace sensor
}  // namespace relidar
