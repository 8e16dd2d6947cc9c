// SPDX-License-Identifier: Apache-2.0
// The table of sensor patterns, with a row for each kind. Sensor files, rigs, logs and
// runs hold a sensor as a JSON object with one member, {"<kind>": {...}}. The row of that
// kind reads and writes the member.
#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include <relidar/log/sensor.hpp>

#include "base/json_field.hpp"

namespace relidar {

/// One kind of pattern. The functions take patterns of this kind only.
struct PatternKind {
    const char* name;     ///< key of its JSON object
    const char* members;  ///< of that object, for the help of the command line
    bool (*holds)(const SensorPattern& pattern);
    /// @param name  of the sensor if the object has none @throws DataError naming the
    /// member that is wrong
    SensorModel (*parse)(const JsonField& field, const std::string& name);
    /// Members of the object, without its name and range limits. They read back to the
    /// same bits.
    nlohmann::ordered_json (*write)(const SensorPattern& pattern);
    RayTable (*make_rays)(const SensorPattern& pattern, double time_s);
    PatternSummary (*describe)(const SensorPattern& pattern);
};

/// A row. The functions are those of the struct of the kind.
/// @tparam functions  has parse, write, make_rays and describe, all static
template <class Functions>
PatternKind pattern_kind(const char* name, const char* members) {
    using Pattern = typename Functions::Pattern;
    return {name,
            members,
            [](const SensorPattern& p) { return std::holds_alternative<Pattern>(p); },
            [](const JsonField& field, const std::string& of) { return Functions::parse(field, of); },
            [](const SensorPattern& p) { return Functions::write(std::get<Pattern>(p)); },
            [](const SensorPattern& p, double t) { return Functions::make_rays(std::get<Pattern>(p), t); },
            [](const SensorPattern& p) { return Functions::describe(std::get<Pattern>(p)); }};
}

/// All kinds.
const std::vector<PatternKind>& pattern_kinds();
/// Two kinds whose members some files hold without a name of the kind.
PatternKind spinning_kind();
PatternKind rays_kind();
/// The kind that an object names, or null if it has no member of such a name.
const PatternKind* find_pattern_kind(const JsonField& field);

namespace pattern_detail {

/// An angle in radians: member NAME_rad, or NAME_deg in degrees.
/// @throws DataError unless one of them is there, within +-most_deg
double read_angle(const JsonField& field, const std::string& name, double most_deg);
/// The same, with a value for an angle that is missing.
double angle_or(const JsonField& field, const std::string& name, double missing_rad, double most_deg);
/// Number of a member, with a value for one that is missing.
double number_or(const JsonField& field, const char* key, double missing, double low, double high);
/// Members divergence_rad or divergence_mrad; 0 where both are missing.
double read_divergence(const JsonField& field);

/// What all kinds have: {name, period_s, divergence_rad or divergence_mrad, min_range_m,
/// max_range_m}. The maximum range is infinite where it is missing.
struct CommonMembers {
    std::string name;
    RangeLimits limits;
    double period_s, divergence_rad;
};
/// @param least_period_s  allowed
CommonMembers read_common(const JsonField& field, const std::string& name, double least_period_s = 1e-6);
/// The members of read_common, then those of the kind. An angle stands for NAME_rad and
/// NAME_deg. @throws DataError for a member that is none of these
void check_members(const JsonField& field, std::vector<std::string> members,
                   const std::vector<std::string>& angles);

/// n-th of so many values that are evenly spaced from first to last.
double between(double first, double last, int i, int n);
/// Appends a ray that starts in the sensor's origin.
void add_ray(RayTable& rays, const glm::dvec3& direction, double time_s, int channel);
/// @throws UsageError unless it is 1 to kMaxRays
void check_count(const std::string& sensor, double n_rays);
/// @param sum  of all angles and rates @throws UsageError unless it is finite and the
/// period positive
void check_finite(const std::string& sensor, double sum, double period_s);

}  // namespace pattern_detail
}  // namespace relidar
