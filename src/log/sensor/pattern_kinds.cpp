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

PatternKind make_scanning_window_pattern_kind();
PatternKind make_rosette_pattern_kind();

const std::vector<PatternKind>& list_pattern_kinds() {
    static const std::vector<PatternKind> kinds{
        make_spinning_pattern_kind(),
        make_scanning_window_pattern_kind(),
        make_rosette_pattern_kind(),
        make_ray_table_pattern_kind(),
    };
    return kinds;
}

namespace {

const PatternKind& get_pattern_kind(const SensorPattern& pattern) {
    return *std::ranges::find_if(list_pattern_kinds(),
                                 [&](const PatternKind& k) { return k.holds(pattern); });
}

constexpr double kLargestRange_m = 1e12, kLongestPeriod_s = 3600.0;

}  // namespace

RayTable make_rays(const SensorPattern& pattern, double time_s) {
    return get_pattern_kind(pattern).make_rays(pattern, time_s);
}

RayTable make_rays(const SensorModel& sensor, double time_s) { return make_rays(sensor.pattern, time_s); }

ScanPatternSummary summarise_scan_pattern(const SensorPattern& pattern) {
    return get_pattern_kind(pattern).describe(pattern);
}

double get_scan_period_s(const SensorPattern& pattern) { return summarise_scan_pattern(pattern).period_s; }

std::optional<SensorPattern> get_non_spinning_pattern(const SensorModel& sensor) {
    if (std::holds_alternative<SpinningSensor>(sensor.pattern)) return {};
    return sensor.pattern;
}

std::string format_pattern_kinds_help() {
    std::string text;
    for (const PatternKind& kind : list_pattern_kinds())
        text += fmt::format("              {{\"{}\": {{{}}}}}\n", kind.name, kind.members);
    return text;
}

const PatternKind* find_pattern_kind(const JsonField& field) {
    for (const PatternKind& kind : list_pattern_kinds())
        if (field.has_member(kind.name)) return &kind;
    return nullptr;
}

SensorModel read_sensor_json(const JsonField& field, const std::string& default_name) {
    const PatternKind* kind = find_pattern_kind(field);
    if (!kind) {
        std::vector<std::string> names;
        for (const PatternKind& k : list_pattern_kinds()) names.emplace_back(fmt::format("\"{}\"", k.name));
        field.throw_field_error("found no scanning pattern",
                                fmt::format("expected one of {}", fmt::join(names, ", ")));
    }
    field.require_only_known_members({kind->name});
    return kind->parse(field.at(kind->name), default_name);
}

std::string format_sensor_json(const SensorModel& sensor) {
    const PatternKind& kind = get_pattern_kind(sensor.pattern);
    nlohmann::ordered_json json = {{"name", sensor.name}, {"min_range_m", sensor.limits.min_m}};
    if (!std::isinf(sensor.limits.max_m)) json["max_range_m"] = sensor.limits.max_m;
    json.update(kind.write(sensor.pattern));
    return nlohmann::ordered_json{{kind.name, json}}.dump(1, ' ', false,
                                                          nlohmann::ordered_json::error_handler_t::replace);
}

namespace sensor {

double read_angle_member_as_rad(const JsonField& field, const std::string& name, double max_abs_deg) {
    const std::string in_rad = name + "_rad", in_deg = name + "_deg";
    if (!field.has_member(in_rad))
        return field.at(in_deg).get_number_in_range(-max_abs_deg, max_abs_deg) * kPi / 180.0;
    if (field.has_member(in_deg))
        field.throw_field_error("found " + in_deg + " and " + in_rad, "expected one of them");
    const double most_rad = max_abs_deg * kPi / 180.0 * (1.0 + 1e-12);
    return field.at(in_rad).get_number_in_range(-most_rad, most_rad);
}

double read_angle_member_or_default_rad(const JsonField& field, const std::string& name, double default_rad,
                                        double max_abs_deg) {
    const bool has = field.has_member(name + "_rad") || field.has_member(name + "_deg");
    return has ? read_angle_member_as_rad(field, name, max_abs_deg) : default_rad;
}

double read_number_member_or_default(const JsonField& field, const char* key, double default_value,
                                     double min_value, double max_value) {
    return field.has_member(key) ? field.at(key).get_number_in_range(min_value, max_value) : default_value;
}

double read_divergence_rad_or_zero(const JsonField& field) {
    if (field.has_member("divergence_rad") && field.has_member("divergence_mrad"))
        field.throw_field_error("found divergence_rad and divergence_mrad", "expected one of them");
    if (field.has_member("divergence_rad")) return field.at("divergence_rad").get_number_in_range(0.0, 1.0);
    return 1e-3 * read_number_member_or_default(field, "divergence_mrad", 0.0, 0.0, 1000.0);
}

CommonSensorMembers read_common_sensor_members(const JsonField& field, const std::string& default_name,
                                               double min_period_s) {
    const CommonSensorMembers common{
        field.has_member("name") ? field.at("name").get_string() : default_name,
        {read_number_member_or_default(field, "min_range_m", 0.0, 0.0, kLargestRange_m),
         read_number_member_or_default(field, "max_range_m", RangeLimits{}.max_m, 0.0, kLargestRange_m)},
        read_number_member_or_default(field, "period_s", 0.1, min_period_s, kLongestPeriod_s),
        read_divergence_rad_or_zero(field)};
    if (!(common.limits.min_m < common.limits.max_m))
        field.throw_field_error(fmt::format("found {} to {} m", common.limits.min_m, common.limits.max_m),
                                "expected min_range_m < max_range_m");
    return common;
}

void require_only_known_sensor_members(const JsonField& field, std::vector<std::string> allowed_member_names,
                                       const std::vector<std::string>& allowed_angle_names) {
    for (const std::string& angle : allowed_angle_names)
        for (const char* unit : {"_deg", "_rad"}) allowed_member_names.push_back(angle + unit);
    for (const char* common :
         {"name", "period_s", "divergence_mrad", "divergence_rad", "min_range_m", "max_range_m"})
        allowed_member_names.emplace_back(common);
    field.require_only_known_members(allowed_member_names);
}

double compute_evenly_spaced_value(double first_value, double last_value, int index, int count) {
    return count > 1 ? first_value + (last_value - first_value) * index / (count - 1)
                     : 0.5 * (first_value + last_value);
}

void append_ray_from_sensor_origin(RayTable& rays, const glm::dvec3& direction, double time_s, int channel) {
    rays.origin.emplace_back(0.0f);
    rays.direction.emplace_back(direction);
    rays.time_offset_s.push_back(float(time_s));
    rays.channel.push_back(std::uint16_t(channel));
}

void require_allowed_ray_count(const std::string& sensor_name, double n_rays) {
    if (!(n_rays >= 1.0 && n_rays <= double(kMaxRays)))
        fail<UsageError>("sensor '{}': found {} rays per scan, expected 1 to {}", sensor_name, n_rays,
                         kMaxRays);
}

void require_finite_sum_and_valid_period(const std::string& sensor_name, double sum_of_values,
                                         double period_s) {
    if (!std::isfinite(sum_of_values))
        fail<UsageError>("sensor '{}': an angle or rate is not finite, expected finite numbers", sensor_name);
    if (!(period_s > 0.0) || !std::isfinite(period_s))
        fail<UsageError>("sensor '{}': found a period of {} s, expected a positive number", sensor_name,
                         period_s);
}

}  // namespace sensor
}  // namespace relidar
