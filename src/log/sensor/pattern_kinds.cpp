// SPDX-License-Identifier: Apache-2.0
#include "log/sensor/pattern_kinds.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>
#include <relidar/log/sensor_pattern.hpp>

namespace relidar {

// Defined in src/log/sensor/kinds.
PatternKind make_window_kind();
PatternKind make_rosette_kind();

const std::vector<PatternKind>& list_pattern_kinds() {
    static const std::vector<PatternKind> kinds{
        make_spinning_kind(),
        make_window_kind(),
        make_rosette_kind(),
        make_rays_kind(),
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

PatternSummary describe_pattern(const SensorPattern& pattern) {
    return get_pattern_kind(pattern).describe(pattern);
}

double get_period(const SensorPattern& pattern) { return describe_pattern(pattern).period_s; }

std::optional<SensorPattern> get_fixed_pattern(const SensorModel& sensor) {
    if (std::holds_alternative<SpinningSensor>(sensor.pattern)) return {};
    return sensor.pattern;
}

std::string describe_pattern_kinds() {
    std::string text;
    for (const PatternKind& kind : list_pattern_kinds())
        text += fmt::format("              {{\"{}\": {{{}}}}}\n", kind.name, kind.members);
    return text;
}

const PatternKind* find_pattern_kind(const JsonField& field) {
    for (const PatternKind& kind : list_pattern_kinds())
        if (field.has(kind.name)) return &kind;
    return nullptr;
}

SensorModel read_sensor_json(const JsonField& field, const std::string& name) {
    const PatternKind* kind = find_pattern_kind(field);
    if (!kind) {
        std::vector<std::string> names;
        for (const PatternKind& k : list_pattern_kinds()) names.emplace_back(fmt::format("\"{}\"", k.name));
        field.fail("found no sensor", fmt::format("expected one of {}", fmt::join(names, ", ")));
    }
    field.check_members({kind->name});
    return kind->parse(field.at(kind->name), name);
}

std::string write_sensor_json(const SensorModel& sensor) {
    const PatternKind& kind = get_pattern_kind(sensor.pattern);
    nlohmann::ordered_json json = {{"name", sensor.name}, {"min_range_m", sensor.limits.min_m}};
    if (!std::isinf(sensor.limits.max_m)) json["max_range_m"] = sensor.limits.max_m;
    json.update(kind.write(sensor.pattern));
    return nlohmann::ordered_json{{kind.name, json}}.dump(1, ' ', false,
                                                          nlohmann::ordered_json::error_handler_t::replace);
}

namespace pattern_detail {

double read_angle(const JsonField& field, const std::string& name, double max_deg) {
    const std::string in_rad = name + "_rad", in_deg = name + "_deg";
    if (!field.has(in_rad)) return field.at(in_deg).number(-max_deg, max_deg) * kPi / 180.0;
    if (field.has(in_deg)) field.fail("found " + in_deg + " and " + in_rad, "expected one of them");
    const double most_rad = max_deg * kPi / 180.0 * (1.0 + 1e-12);
    return field.at(in_rad).number(-most_rad, most_rad);
}

double read_angle_or(const JsonField& field, const std::string& name, double missing_rad, double max_deg) {
    const bool has = field.has(name + "_rad") || field.has(name + "_deg");
    return has ? read_angle(field, name, max_deg) : missing_rad;
}

double read_number_or(const JsonField& field, const char* key, double default_value, double low,
                      double high) {
    return field.has(key) ? field.at(key).number(low, high) : default_value;
}

double read_divergence(const JsonField& field) {
    if (field.has("divergence_rad") && field.has("divergence_mrad"))
        field.fail("found divergence_rad and divergence_mrad", "expected one of them");
    if (field.has("divergence_rad")) return field.at("divergence_rad").number(0.0, 1.0);
    return 1e-3 * read_number_or(field, "divergence_mrad", 0.0, 0.0, 1000.0);
}

CommonMembers read_common(const JsonField& field, const std::string& name, double min_period_s) {
    const CommonMembers common{
        field.has("name") ? field.at("name").text() : name,
        {read_number_or(field, "min_range_m", 0.0, 0.0, kLargestRange_m),
         read_number_or(field, "max_range_m", RangeLimits{}.max_m, 0.0, kLargestRange_m)},
        read_number_or(field, "period_s", 0.1, min_period_s, kLongestPeriod_s),
        read_divergence(field)};
    if (!(common.limits.min_m < common.limits.max_m))
        field.fail(fmt::format("found {} to {} m", common.limits.min_m, common.limits.max_m),
                   "expected min_range_m < max_range_m");
    return common;
}

void check_members(const JsonField& field, std::vector<std::string> members,
                   const std::vector<std::string>& angles) {
    for (const std::string& angle : angles)
        for (const char* unit : {"_deg", "_rad"}) members.push_back(angle + unit);
    for (const char* common :
         {"name", "period_s", "divergence_mrad", "divergence_rad", "min_range_m", "max_range_m"})
        members.emplace_back(common);
    field.check_members(members);
}

double interpolate_evenly(double first, double last, int index, int count) {
    return count > 1 ? first + (last - first) * index / (count - 1) : 0.5 * (first + last);
}

void add_ray(RayTable& rays, const glm::dvec3& direction, double time_s, int channel) {
    rays.origin.emplace_back(0.0f);
    rays.direction.emplace_back(direction);
    rays.time_offset_s.push_back(static_cast<float>(time_s));
    rays.channel.push_back(static_cast<std::uint16_t>(channel));
}

void check_count(const std::string& sensor, double n_rays) {
    if (!(n_rays >= 1.0 && n_rays <= double(kMaxRays)))
        throw UsageError(
            fmt::format("sensor '{}' has {} rays per scan, expected 1 to {}", sensor, n_rays, kMaxRays));
}

void check_finite(const std::string& sensor, double sum, double period_s) {
    if (!std::isfinite(sum))
        throw UsageError(
            fmt::format("sensor '{}': an angle or rate is not finite, expected finite numbers", sensor));
    if (!(period_s > 0.0) || !std::isfinite(period_s))
        throw UsageError(
            fmt::format("sensor '{}' has a period of {} s, expected a positive number", sensor, period_s));
}

}  // namespace pattern_detail
}  // namespace relidar
