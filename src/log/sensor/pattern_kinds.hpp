// SPDX-License-Identifier: Apache-2.0
// Table of the kinds of sensors, such as "spinning" or "rays". Sensor files, rigs, logs
// and runs store a sensor as a JSON object with one member, {"<kind>": {...}}. The table
// row of a kind contains the functions that read and write this member.
#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include <relidar/log/sensor.hpp>

#include "base/json_field.hpp"

namespace relidar {

/// Name and functions of one kind of sensor, such as "spinning". holds() tests if a
/// pattern is of this kind. The other functions accept only such patterns.
struct PatternKind {
    const char* name;     ///< key of the JSON object that describes the sensor
    const char* members;  ///< names of the members of the JSON object, for the command-line help
    bool (*holds)(const SensorPattern& pattern);
    /// Creates a sensor from its JSON object.
    /// @param name  name of the sensor if the object contains none
    /// @throws DataError naming the member that is wrong
    SensorModel (*parse)(const JsonField& field, const std::string& name);
    /// Returns the pattern as a JSON object, to which the caller adds the sensor's name
    /// and range limits. Reading the object back gives exactly the same pattern.
    nlohmann::ordered_json (*write)(const SensorPattern& pattern);
    RayTable (*make_rays)(const SensorPattern& pattern, double time_s);
    ScanPatternSummary (*describe)(const SensorPattern& pattern);
};

/// Creates the PatternKind of a sensor from the static functions of a struct.
/// @tparam Functions  struct with the type Pattern and the static functions parse, write,
/// make_rays and describe
template <class Functions>
PatternKind make_scan_pattern_kind(const char* kind_name, const char* json_member_names) {
    using Pattern = typename Functions::Pattern;
    return {kind_name,
            json_member_names,
            [](const SensorPattern& p) { return std::holds_alternative<Pattern>(p); },
            [](const JsonField& field, const std::string& of) { return Functions::parse(field, of); },
            [](const SensorPattern& p) { return Functions::write(std::get<Pattern>(p)); },
            [](const SensorPattern& p, double t) { return Functions::make_rays(std::get<Pattern>(p), t); },
            [](const SensorPattern& p) { return Functions::describe(std::get<Pattern>(p)); }};
}

/// Returns the table of all kinds of sensors.
const std::vector<PatternKind>& list_pattern_kinds();
/// Returns the name and functions of the sensor kind "spinning". In a log folder, a JSON
/// object without a kind is parsed as this kind.
PatternKind make_spinning_pattern_kind();
/// Returns the name and functions of the sensor kind "rays" (a table of rays). In a
/// sensor file, a JSON object with the member "directions" is parsed as this kind.
PatternKind make_ray_table_pattern_kind();
/// Returns the kind of sensor that a JSON object names, or null if it names none.
const PatternKind* find_pattern_kind(const JsonField& field);

namespace pattern_detail {

/// Reads an angle from the JSON member NAME_rad in radians or NAME_deg in degrees.
/// @return radians
/// @throws DataError if both members are missing, or the angle is outside +-max_abs_deg
double read_angle_member_as_rad(const JsonField& field, const std::string& name, double max_abs_deg);
/// Reads an angle from the JSON member NAME_rad or NAME_deg. Returns `default_rad` if
/// both are missing.
double read_angle_member_or_default_rad(const JsonField& field, const std::string& name, double default_rad,
                                        double max_abs_deg);
/// Returns the number in a JSON member, or `default_value` if the member is missing.
double read_number_member_or_default(const JsonField& field, const char* key, double default_value,
                                     double min_value, double max_value);
/// Reads a beam divergence from the JSON member divergence_rad or divergence_mrad.
/// Returns 0 if both are missing.
double read_divergence_rad_or_zero(const JsonField& field);

/// JSON members of all kinds of sensors: name, period_s, divergence_rad or
/// divergence_mrad, min_range_m, max_range_m. A missing max_range_m means infinity.
struct CommonSensorMembers {
    std::string name;
    RangeLimits limits;
    double period_s, divergence_rad;
};
/// Reads the JSON members that all kinds of sensors can have.
/// @param min_period_s  smallest allowed period
CommonSensorMembers read_common_sensor_members(const JsonField& field, const std::string& default_name,
                                               double min_period_s = 1e-6);
/// Throws if a sensor's JSON object has an unknown member. Known members are those of all
/// sensors, and `allowed_member_names`. An angle NAME is stored as NAME_rad or NAME_deg.
/// @throws DataError for an unknown member
void require_only_known_sensor_members(const JsonField& field, std::vector<std::string> allowed_member_names,
                                       const std::vector<std::string>& allowed_angle_names);

/// Returns value number `index` of `count` evenly spaced values from `first_value` to
/// `last_value`.
double compute_evenly_spaced_value(double first_value, double last_value, int index, int count);
/// Appends a ray that starts at the sensor origin.
void append_ray_from_sensor_origin(RayTable& rays, const glm::dvec3& direction, double time_s, int channel);
/// Checks the number of rays of a sensor.
/// @throws UsageError if the number is not in the range 1 to kMaxRays
void require_allowed_ray_count(const std::string& sensor_name, double n_rays);
/// Checks that the values of a sensor pattern are finite and that its period is positive.
/// @param sum_of_values  sum of all angles and rates; it is not finite if one of them is
/// not finite
/// @throws UsageError if a check fails
void require_finite_sum_and_valid_period(const std::string& sensor_name, double sum_of_values,
                                         double period_s);

}  // namespace pattern_detail
}  // namespace relidar
