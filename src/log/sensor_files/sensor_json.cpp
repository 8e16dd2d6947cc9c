// SPDX-License-Identifier: Apache-2.0
// Sensors as JSON: a ray table, or the metadata that Ouster's own tools write, in its old
// flat form or the newer nested one. Ouster's LiDAR frame has x towards the connector,
// backwards; ours is that frame turned by 180 degrees about z. With column m of W, beam
// azimuth a and origin offset n:   head azimuth = pi - 2 pi m / W,   ray azimuth = head
// azimuth - a,   origin = n along the head.
#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>
#include "base/files.hpp"
#include "base/json_field.hpp"
#include "log/sensor_files/ray_arrays.hpp"

namespace relidar::sensor_files {
namespace {

using Json = nlohmann::json;

constexpr std::size_t kMostBeams = 1024;
constexpr int kDeepest = 3;  // rows, columns, vectors

/// What a key holds, in the object or in one of its parts.
const Json* find(const Json& json, const std::string& key, std::initializer_list<const char*> parts) {
    if (json.contains(key)) return &json.at(key);
    for (const char* part : parts)
        if (json.contains(part) && json.at(part).is_object() && json.at(part).contains(key))
            return &json.at(part).at(key);
    return nullptr;
}

/// Appends the numbers of nested lists. @param depth  how many lists there may be in one
/// another
/// @throws DataError for anything that is no number
void collect(const Json& json, std::vector<double>& numbers, int depth, const std::string& where) {
    if (json.is_number()) {
        numbers.push_back(json.get<double>());
    } else if (json.is_array() && depth > 0) {
        for (const Json& item : json) collect(item, numbers, depth - 1, where);
    } else {
        throw DataError(fmt::format("{}: found {}, expected numbers", where,
                                    json.is_array() ? "lists nested too deep" : json.type_name()));
    }
}

std::vector<double> numbers_of(const Json* json, const std::string& where) {
    std::vector<double> numbers;
    if (json) collect(*json, numbers, kDeepest, where);
    return numbers;
}

double number_of(const Json* json, double missing, const std::string& where) {
    if (!json) return missing;
    if (!json->is_number() || !std::isfinite(json->get<double>()))
        throw DataError(fmt::format("{}: expected a number", where));
    return json->get<double>();
}

/// Lists may be flat, [n] vectors, or [rows] lists of them.
SensorModel rays_of_json(const Json& json, const std::string& name, const std::string& where) {
    const auto list = [&](const char* key) {
        return numbers_of(find(json, key, {}), fmt::format("{}: {}", where, key));
    };
    const auto number = [&](const char* key, double missing) {
        return number_of(find(json, key, {}), missing, fmt::format("{}: {}", where, key));
    };
    JsonField(json, where, "")
        .check_members({"directions", "origin", "time", "ring", "divergence", "divergence_mrad",
                        "min_range_m", "max_range_m"});
    RayColumns c{.direction = list("directions"),
                 .origin = list("origin"),
                 .time_s = list("time"),
                 .channel = list("ring")};
    const Json& directions = json.at("directions");
    const bool image = directions.is_array() && !directions.empty() && directions[0].is_array() &&
                       !directions[0].empty() && directions[0][0].is_array();
    c.rows = image ? static_cast<int>(std::min(directions.size(), kMaxRays)) : 1;
    c.columns =
        static_cast<int>(std::min(c.direction.size() / 3 / static_cast<std::size_t>(c.rows), kMaxRays));
    const Json* of_all = find(json, "divergence_mrad", {});
    c.divergence_rad = divergence_of(
        list("divergence"), of_all ? std::optional(number("divergence_mrad", 0.0)) : std::nullopt, where);
    c.limits = {number("min_range_m", c.limits.min_m), number("max_range_m", c.limits.max_m)};
    return ray_sensor(c, name, where);
}

RangeLimits ouster_limits(const Json& json) {
    const Json* line = find(json, "prod_line", {"sensor_info"});
    const std::string product = line && line->is_string() ? line->get<std::string>() : "";
    const auto known = product.starts_with("OS-0")   ? known_sensor("OS0-128")
                       : product.starts_with("OS-2") ? known_sensor("OS2-128")
                                                     : known_sensor("OS1-128");
    return known->limits;
}

/// Columns and rate of a mode such as "1024x10".
std::pair<int, double> ouster_mode(const Json& json, const std::string& where) {
    const Json* mode = find(json, "lidar_mode", {"config_params"});
    const std::string text = mode && mode->is_string() ? mode->get<std::string>() : "";
    const std::size_t x = text.find('x');
    const auto columns = parse_number(std::string_view(text).substr(0, x));
    const auto rate =
        x == std::string::npos ? std::nullopt : parse_number(std::string_view(text).substr(x + 1));
    if (!columns || !rate || !(*columns >= 1 && *columns <= 65536) || !(*rate > 0.0 && *rate <= 1000.0))
        throw DataError(fmt::format("{}: lidar_mode is \"{}\", expected columns and rate as in \"1024x10\"",
                                    where, excerpt(text)));
    return {static_cast<int>(*columns), *rate};
}

SensorModel ouster_sensor(const Json& json, const std::string& name, const std::string& where, int columns,
                          double rate_hz) {
    const auto list = [&](const char* key) {
        return numbers_of(find(json, key, {"beam_intrinsics"}), fmt::format("{}: {}", where, key));
    };
    const std::vector<double> altitude = list("beam_altitude_angles"), azimuth = list("beam_azimuth_angles");
    if (altitude.empty() || altitude.size() > kMostBeams || azimuth.size() != altitude.size()) {
        throw DataError(
            fmt::format("{}: found {} beam_altitude_angles and {} beam_azimuth_angles, expected as many of "
                        "both, at most {}",
                        where, altitude.size(), azimuth.size(), kMostBeams));
    }
    const double offset_m =
        1e-3 * number_of(find(json, "lidar_origin_to_beam_origin_mm", {"beam_intrinsics"}), 0.0,
                         where + ": lidar_origin_to_beam_origin_mm");
    SpinningSensor sensor;
    const auto [mode_columns, mode_rate_hz] =
        columns > 0 ? std::pair(columns, rate_hz) : ouster_mode(json, where);
    sensor.name = name;
    sensor.columns = mode_columns;
    sensor.period_s = 1.0 / mode_rate_hz;
    sensor.first_azimuth_rad = kPi;
    const RangeLimits limits = ouster_limits(json);
    sensor.min_range_m = limits.min_m;
    sensor.max_range_m = limits.max_m;
    for (std::size_t b = 0; b < altitude.size(); ++b) {
        if (!(std::abs(altitude[b]) <= 90.0 && std::abs(azimuth[b]) <= 180.0 && std::abs(offset_m) < 1.0))
            throw DataError(
                fmt::format("{}: beam {} has altitude {}, azimuth {} and starts {} m from the axis, expected "
                            "angles in degrees and less than 1 m",
                            where, b, altitude[b], azimuth[b], offset_m));
        sensor.beams.push_back({.elevation_rad = altitude[b] * kPi / 180.0,
                                .azimuth_offset_rad = -azimuth[b] * kPi / 180.0,
                                .origin_offset_m = offset_m});
    }
    std::ranges::stable_sort(sensor.beams, std::greater<>(), &Beam::elevation_rad);
    return {name, "", limits, std::move(sensor)};
}

double degrees_of(const JsonField& field, const char* key, double most) {
    return field.at(key).number(-most, most) * kPi / 180.0;
}

/// What is the same for whatever sweeps.
struct Common {
    RangeLimits limits;
    double period_s, divergence_rad;
};
Common common_of(const JsonField& field) {
    const auto number = [&](const char* key, double missing, double low, double high) {
        return field.has(key) ? field.at(key).number(low, high) : missing;
    };
    const Common common{
        {number("min_range_m", 0.0, 0.0, 1e4), number("max_range_m", RangeLimits{}.max_m, 0.0, 1e4)},
        number("period_s", 0.1, 1e-4, 10.0),
        1e-3 * number("divergence_mrad", 0.0, 0.0, 100.0)};
    if (!(common.limits.min_m < common.limits.max_m))
        field.fail(fmt::format("found {} to {} m", common.limits.min_m, common.limits.max_m),
                   "expected min_range_m < max_range_m");
    return common;
}

SensorModel window_of(const JsonField& field, const std::string& name) {
    field.check_members({"rows", "columns", "left_deg", "right_deg", "top_deg", "bottom_deg", "period_s",
                         "divergence_mrad", "min_range_m", "max_range_m"});
    const Common common = common_of(field);
    const ScanningWindow window{.name = name,
                                .rows = static_cast<int>(field.at("rows").integer(1, 65535)),
                                .columns = static_cast<int>(field.at("columns").integer(1, 1'000'000)),
                                .left_rad = degrees_of(field, "left_deg", 180.0),
                                .right_rad = degrees_of(field, "right_deg", 180.0),
                                .top_rad = degrees_of(field, "top_deg", 90.0),
                                .bottom_rad = degrees_of(field, "bottom_deg", 90.0),
                                .period_s = common.period_s,
                                .divergence_rad = common.divergence_rad};
    if (std::size_t(window.rows) * std::size_t(window.columns) > kMaxRays)
        field.fail(fmt::format("found {} rows x {} columns", window.rows, window.columns),
                   fmt::format("expected at most {} rays", kMaxRays));
    return {name, "", common.limits, window};
}

SensorModel rosette_of(const JsonField& field, const std::string& name) {
    field.check_members({"rays", "deflection_deg", "first_hz", "second_hz", "period_s", "divergence_mrad",
                         "min_range_m", "max_range_m"});
    const Common common = common_of(field);
    return {name, "", common.limits,
            Rosette{.name = name,
                    .deflection_rad = degrees_of(field, "deflection_deg", 45.0),
                    .first_hz = field.at("first_hz").number(-1e5, 1e5),
                    .second_hz = field.at("second_hz").number(-1e5, 1e5),
                    .n_rays = static_cast<int>(field.at("rays").integer(1, std::int64_t(kMaxRays))),
                    .period_s = common.period_s,
                    .divergence_rad = common.divergence_rad}};
}

}  // namespace

SensorModel parse_sensor_json(const std::string& text, const std::string& name, const std::string& where,
                              int columns, double rate_hz) {
    Json json;
    try {
        json = Json::parse(text);
    } catch (const Json::exception& error) {
        throw DataError(
            fmt::format("{}: no valid JSON ({}), expected a sensor", where, excerpt(error.what())));
    }
    if (json.is_object() && json.contains("directions")) return rays_of_json(json, name, where);
    const JsonField root(json, where, "");
    if (root.has("window") || root.has("rosette")) {
        const std::string kind = root.has("window") ? "window" : "rosette";
        root.check_members({kind});
        return kind == "window" ? window_of(root.at(kind), name) : rosette_of(root.at(kind), name);
    }
    if (json.is_object() && find(json, "beam_altitude_angles", {"beam_intrinsics"}))
        return ouster_sensor(json, name, where, columns, rate_hz);
    throw DataError(
        fmt::format("{}: found none of \"directions\", \"window\", \"rosette\" and \"beam_altitude_angles\", "
                    "expected a ray table, what "
                    "sweeps, or Ouster's metadata",
                    where));
}

}  // namespace relidar::sensor_files
