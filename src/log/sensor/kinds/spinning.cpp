// SPDX-License-Identifier: Apache-2.0
// Reads and writes sensors of the kind "spinning". Such a sensor has a rotating head with
// several beams.
#include <relidar/base/math.hpp>

#include <fmt/format.h>

#include "log/sensor/pattern_kinds.hpp"

namespace relidar {

using namespace sensor;
namespace {

// of a beam from the origin of the sensor
constexpr double kFarthestBeam_m = 100.0;
// gains, intensity offsets and range offsets (metres)
constexpr double kLargestResponse = 1e3;
constexpr double kMaxAngle_deg = 5730.0;  // 100 radians
constexpr std::size_t kMostBeams = 65534;

Beam read_beam(const JsonField& field) {
    field.check_members({"elevation_deg", "elevation_rad", "azimuth_offset_deg", "azimuth_offset_rad",
                         "origin_offset_m", "origin_up_m", "origin_left_m", "intensity_gain",
                         "intensity_offset", "range_offset_m"});
    const auto number = [&](const char* key, double default_value, double most) {
        return read_number_or(field, key, default_value, -most, most);
    };
    return {.elevation_rad = read_angle_rad(field, "elevation", 90.0),
            .azimuth_offset_rad = read_angle_or_rad(field, "azimuth_offset", 0.0, kMaxAngle_deg),
            .origin_offset_m = number("origin_offset_m", 0.0, kFarthestBeam_m),
            .origin_up_m = number("origin_up_m", 0.0, kFarthestBeam_m),
            .origin_left_m = number("origin_left_m", 0.0, kFarthestBeam_m),
            .intensity_gain = number("intensity_gain", 1.0, kLargestResponse),
            .intensity_offset = number("intensity_offset", 0.0, kLargestResponse),
            .range_offset_m = number("range_offset_m", 0.0, kLargestResponse)};
}

void read_beams(const JsonField& field, SpinningSensor& sensor) {
    const JsonField beams = field.at("beams");
    for (std::size_t i = 0; i < beams.size(); ++i) sensor.beams.push_back(read_beam(beams.at(i)));
    if (sensor.beams.empty() || sensor.beams.size() > kMostBeams)
        beams.reject(fmt::format("found {} beams", sensor.beams.size()),
                     fmt::format("expected 1 to {}", kMostBeams));
    if (sensor.beams.front().elevation_rad < sensor.beams.back().elevation_rad)
        beams.reject("found the lowest beam first", "expected the highest beam first");
    sensor.columns = int(field.at("columns").integer_in(1, 1'000'000));
    if (sensor.beams.size() * std::size_t(sensor.columns) > kMaxRays)
        beams.reject(fmt::format("found {} beams x {} columns", sensor.beams.size(), sensor.columns),
                     fmt::format("expected at most {} rays", kMaxRays));
}

nlohmann::ordered_json make_beam_json(const Beam& beam) {
    nlohmann::ordered_json json = {{"elevation_rad", beam.elevation_rad}};
    const auto add = [&](const char* key, double value, double default_value) {
        if (value != default_value) json[key] = value;
    };
    add("azimuth_offset_rad", beam.azimuth_offset_rad, 0.0);
    add("origin_offset_m", beam.origin_offset_m, 0.0);
    add("origin_up_m", beam.origin_up_m, 0.0);
    add("origin_left_m", beam.origin_left_m, 0.0);
    add("intensity_gain", beam.intensity_gain, 1.0);
    add("intensity_offset", beam.intensity_offset, 0.0);
    add("range_offset_m", beam.range_offset_m, 0.0);
    return json;
}

/// Reads the azimuths of the first and the last ray, azimuth_deg or azimuth_rad.
std::optional<std::array<double, 2>> read_azimuths(const JsonField& field) {
    const bool in_rad = field.has_member("azimuth_rad");
    if (!in_rad && !field.has_member("azimuth_deg")) return {};
    const JsonField pair = field.at(in_rad ? "azimuth_rad" : "azimuth_deg");
    std::array<double, 2> azimuths = pair.numbers<2>();
    for (double& azimuth : azimuths) azimuth *= in_rad ? 1.0 : kPi / 180.0;
    if (azimuths[0] == azimuths[1] || std::max(std::abs(azimuths[0]), std::abs(azimuths[1])) > 6.2832)
        pair.reject("found another pair of numbers",
                    "expected two different azimuths of at most 360 degrees, in the order of rotation");
    return azimuths;
}

struct SpinningFunctions {
    using Pattern = SpinningSensor;

    /// Reads a spinning sensor from JSON. The beams can be missing if only the scans of a
    /// LiDAR are known.
    static SensorModel parse(const JsonField& field, const std::string& default_name) {
        check_members(field, {"beams", "columns", "clockwise"}, {"first_azimuth", "azimuth"});
        SpinningSensor sensor;
        const auto common = read_common(field, default_name, 0.0);
        sensor.name = common.name;
        sensor.period_s = common.period_s;
        sensor.min_range_m = common.limits.min_m;
        sensor.max_range_m = common.limits.max_m;
        sensor.divergence_rad = common.divergence_rad;
        if (field.has_member("clockwise")) sensor.clockwise = field.at("clockwise").boolean();
        if (field.has_member("beams")) read_beams(field, sensor);
        const double middle = sensor.columns > 0 ? (180.0 - 180.0 / sensor.columns) * kPi / 180.0 : 0.0;
        sensor.first_azimuth_rad = read_angle_or_rad(field, "first_azimuth", middle, kMaxAngle_deg);
        sensor.azimuth_rad = read_azimuths(field);
        return {sensor.name, "", common.limits, std::move(sensor)};
    }
    static nlohmann::ordered_json write(const SpinningSensor& sensor) {
        nlohmann::ordered_json json = {{"period_s", sensor.period_s},
                                       {"divergence_rad", sensor.divergence_rad},
                                       {"clockwise", sensor.clockwise},
                                       {"first_azimuth_rad", sensor.first_azimuth_rad}};
        if (sensor.azimuth_rad) json["azimuth_rad"] = *sensor.azimuth_rad;
        if (sensor.beams.empty()) return json;
        json["columns"] = sensor.columns;
        json["beams"] = nlohmann::ordered_json::array();
        for (const Beam& beam : sensor.beams) json["beams"].push_back(make_beam_json(beam));
        return json;
    }
    static RayTable make_rays(const SpinningSensor& sensor, double) { return relidar::make_rays(sensor); }
    static ScanPatternSummary describe(const SpinningSensor& sensor) {
        return {.n_rays = sensor.beams.size() * fired_columns(sensor).size(), .period_s = sensor.period_s};
    }
};

}  // namespace

PatternKind spinning_kind() {
    return make_kind<SpinningFunctions>(
        "spinning",
        "columns, beams: [{elevation_deg, azimuth_offset_deg, ...}], azimuth_deg: "
        "[first, last]");
}

}  // namespace relidar
