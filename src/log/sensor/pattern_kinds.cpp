// SPDX-License-Identifier: Apache-2.0
#include "log/sensor/pattern_kinds.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>
#include <relidar/log/sensor_pattern.hpp>

#include "base/fail.hpp"

namespace relidar {
namespace {

constexpr double kLargestRange_m = 1e12, kLongestPeriod_s = 3600.0;

/// Reads divergence_rad or divergence_mrad; 0 if both are missing.
double read_divergence_rad(const JsonField& field) {
    if (field.has_member("divergence_rad") && field.has_member("divergence_mrad"))
        field.reject("found divergence_rad and divergence_mrad", "expected one of them");
    if (field.has_member("divergence_rad")) return field.at("divergence_rad").number_in(0.0, 1.0);
    return 1e-3 * sensor::read_number_or(field, "divergence_mrad", 0.0, 0.0, 1000.0);
}

}  // namespace

/// Returns the kinds of sensors: the key in JSON, the members for the help, and the
/// parser. The order is that of SensorPattern.
const std::vector<PatternKind>& all_pattern_kinds() {
    static const std::vector<PatternKind> kinds{
        {"spinning", "columns, beams: [{elevation_deg, azimuth_offset_deg, ...}], azimuth_deg: [first, last]",
         sensor::parse_spinning},
        {"window", "rows, columns, left_deg, right_deg, top_deg, bottom_deg", sensor::parse_window},
        {"rosette", "rays, deflection_deg, first_hz, second_hz", sensor::parse_rosette},
        {"rays", "directions: [[x, y, z], ...], origin: [[x, y, z], ...], time: [...], ring: [...]",
         sensor::parse_ray_table},
    };
    return kinds;
}

RayTable make_rays(const SensorPattern& pattern, double time_s) {
    if (const auto* rays = std::get_if<RayTable>(&pattern)) return *rays;
    if (const auto* rosette = std::get_if<RosetteSensor>(&pattern)) return make_rays(*rosette, time_s);
    if (const auto* window = std::get_if<WindowScanSensor>(&pattern)) return make_rays(*window);
    return make_rays(std::get<SpinningSensor>(pattern));
}

RayTable make_rays(const SensorModel& sensor, double time_s) { return make_rays(sensor.pattern, time_s); }
ScanPatternSummary summarise_pattern(const SensorPattern& pattern) {
    return std::visit([](const auto& sensor) { return sensor::describe(sensor); }, pattern);
}

double scan_period_s(const SensorPattern& pattern) { return summarise_pattern(pattern).period_s; }

std::optional<SensorPattern> other_pattern(const SensorModel& sensor) {
    if (std::holds_alternative<SpinningSensor>(sensor.pattern)) return {};
    return sensor.pattern;
}

std::string pattern_help() {
    std::string text;
    for (const PatternKind& kind : all_pattern_kinds())
        text += fmt::format("              {{\"{}\": {{{}}}}}\n", kind.name, kind.members);
    return text;
}

const PatternKind* find_kind(const JsonField& field) {
    for (const PatternKind& kind : all_pattern_kinds())
        if (field.has_member(kind.name)) return &kind;
    return nullptr;
}

SensorModel read_sensor_json(const JsonField& field, const std::string& default_name) {
    const PatternKind* kind = find_kind(field);
    if (!kind) {
        std::vector<std::string> names;
        for (const PatternKind& k : all_pattern_kinds()) names.emplace_back(fmt::format("\"{}\"", k.name));
        field.reject("found no scanning pattern", fmt::format("expected one of {}", fmt::join(names, ", ")));
    }
    field.check_members({kind->name});
    return kind->parse(field.at(kind->name), default_name);
}

std::string format_sensor_json(const SensorModel& sensor) {
    nlohmann::ordered_json json = {{"name", sensor.name}, {"min_range_m", sensor.limits.min_m}};
    if (!std::isinf(sensor.limits.max_m)) json["max_range_m"] = sensor.limits.max_m;
    json.update(std::visit([](const auto& pattern) { return sensor::write(pattern); }, sensor.pattern));
    return nlohmann::ordered_json{{all_pattern_kinds()[sensor.pattern.index()].name, json}}.dump(
        1, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
}

namespace sensor {

double read_angle_rad(const JsonField& field, const std::string& name, double max_abs_deg) {
    const std::string in_rad = name + "_rad", in_deg = name + "_deg";
    if (!field.has_member(in_rad)) return field.at(in_deg).number_in(-max_abs_deg, max_abs_deg) * kPi / 180.0;
    if (field.has_member(in_deg)) field.reject("found " + in_deg + " and " + in_rad, "expected one of them");
    const double most_rad = max_abs_deg * kPi / 180.0 * (1.0 + 1e-12);
    return field.at(in_rad).number_in(-most_rad, most_rad);
}

double read_angle_or_rad(const JsonField& field, const std::string& name, double default_rad,
                         double max_abs_deg) {
    const bool has = field.has_member(name + "_rad") || field.has_member(name + "_deg");
    return has ? read_angle_rad(field, name, max_abs_deg) : default_rad;
}

double read_number_or(const JsonField& field, const char* key, double default_value, double min, double max) {
    return field.has_member(key) ? field.at(key).number_in(min, max) : default_value;
}

CommonMembers read_common(const JsonField& field, const std::string& default_name, double min_s) {
    const CommonMembers common{
        .name = field.has_member("name") ? field.at("name").text() : default_name,
        .limits = {read_number_or(field, "min_range_m", 0.0, 0.0, kLargestRange_m),
                   read_number_or(field, "max_range_m", RangeLimits{}.max_m, 0.0, kLargestRange_m)},
        .period_s = read_number_or(field, "period_s", 0.1, min_s, kLongestPeriod_s),
        .divergence_rad = read_divergence_rad(field)};
    if (!(common.limits.min_m < common.limits.max_m))
        field.reject(fmt::format("found {} to {} m", common.limits.min_m, common.limits.max_m),
                     "expected min_range_m < max_range_m");
    return common;
}

void check_members(const JsonField& field, std::vector<std::string> allowed_member_names,
                   const std::vector<std::string>& allowed_angle_names) {
    for (const std::string& angle : allowed_angle_names)
        for (const char* unit : {"_deg", "_rad"}) allowed_member_names.push_back(angle + unit);
    for (const char* common :
         {"name", "period_s", "divergence_mrad", "divergence_rad", "min_range_m", "max_range_m"})
        allowed_member_names.emplace_back(common);
    field.check_members(allowed_member_names);
}

void add_ray(RayTable& rays, const glm::dvec3& direction, double time_s, int channel) {
    rays.origin.emplace_back(0.0f);
    rays.direction.emplace_back(direction);
    rays.time_offset_s.push_back(float(time_s));
    rays.channel.push_back(std::uint16_t(channel));
}

void check_ray_count(const std::string& sensor_name, double n_rays) {
    if (!(n_rays >= 1.0 && n_rays <= double(kMaxRays)))
        fail<UsageError>("sensor '{}': found {} rays per scan, expected 1 to {}", sensor_name, n_rays,
                         kMaxRays);
}

void check_pattern(const std::string& sensor_name, double period_s, std::initializer_list<double> values) {
    if (!std::ranges::all_of(values, [](double value) { return std::isfinite(value); }))
        fail<UsageError>("sensor '{}': an angle or rate is not finite, expected finite numbers", sensor_name);
    if (!(period_s > 0.0) || !std::isfinite(period_s))
        fail<UsageError>("sensor '{}': found a period of {} s, expected a positive number", sensor_name,
                         period_s);
}

}  // namespace sensor
}  // namespace relidar
