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
struct BeamMember {
    const char* key;
    double Beam::*member;
    double max;
};
// Members of a beam that a file leaves out if they have their default values.
constexpr BeamMember kBeamMembers[] = {{"origin_offset_m", &Beam::origin_offset_m, kFarthestBeam_m},
                                       {"origin_up_m", &Beam::origin_up_m, kFarthestBeam_m},
                                       {"origin_left_m", &Beam::origin_left_m, kFarthestBeam_m},
                                       {"intensity_gain", &Beam::intensity_gain, kLargestResponse},
                                       {"intensity_offset", &Beam::intensity_offset, kLargestResponse},
                                       {"range_offset_m", &Beam::range_offset_m, kLargestResponse}};
constexpr double kMaxAngle_deg = 5730.0;  // 100 radians
constexpr std::size_t kMostBeams = 65534;

/// Reads a beam. Only its elevation is required.
Beam read_beam(const JsonField& field) {
    field.check_members({"elevation_deg", "elevation_rad", "azimuth_offset_deg", "azimuth_offset_rad",
                         "origin_offset_m", "origin_up_m", "origin_left_m", "intensity_gain",
                         "intensity_offset", "range_offset_m"});
    Beam beam{.elevation_rad = read_angle_rad(field, "elevation", 90.0),
              .azimuth_offset_rad = read_angle_or_rad(field, "azimuth_offset", 0.0, kMaxAngle_deg)};
    for (const auto& [key, member, max] : kBeamMembers)
        beam.*member = read_number_or(field, key, beam.*member, -max, max);
    return beam;
}

/// Reads the list of beams, from the highest to the lowest, and the number of columns.
void read_beams(const JsonField& field, SpinningSensor& sensor) {
    const JsonField beams = field.at("beams");
    sensor.beams = beams.list(read_beam);
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
    if (beam.azimuth_offset_rad != 0.0) json["azimuth_offset_rad"] = beam.azimuth_offset_rad;
    for (const auto& [key, member, max] : kBeamMembers)
        if (beam.*member != Beam{}.*member) json[key] = beam.*member;
    return json;
}

/// Reads the field of view: the azimuths of the first and the last ray of a turn, as
/// azimuth_deg or azimuth_rad. Returns nothing if both are missing.
/// @return radians
std::optional<std::array<double, 2>> read_azimuths(const JsonField& field) {
    constexpr double kMaxAzimuth_rad = 6.2832;  // 360 degrees, rounded up
    const bool is_in_rad = field.has_member("azimuth_rad");
    if (!is_in_rad && !field.has_member("azimuth_deg")) return {};
    const JsonField pair = field.at(is_in_rad ? "azimuth_rad" : "azimuth_deg");
    std::array<double, 2> azimuths = pair.numbers<2>();
    for (double& azimuth : azimuths) azimuth *= is_in_rad ? 1.0 : kPi / 180.0;
    const double largest_rad = std::max(std::abs(azimuths[0]), std::abs(azimuths[1]));
    if (azimuths[0] == azimuths[1] || largest_rad > kMaxAzimuth_rad)
        pair.reject(fmt::format("found {} to {} radians", azimuths[0], azimuths[1]),
                    "expected two different azimuths of at most 360 degrees, in the order of rotation");
    return azimuths;
}

}  // namespace

/// Reads a spinning sensor from its JSON object. In a log of which only the scans are
/// known, the object has no beams, and its period can be 0, which means unknown.
SensorModel sensor::parse_spinning(const JsonField& field, const std::string& default_name) {
    check_members(field, {"beams", "columns", "clockwise"}, {"first_azimuth", "azimuth"});
    constexpr double kUnknownPeriod_s = 0.0;
    const CommonMembers common = read_common(field, default_name, kUnknownPeriod_s);
    SpinningSensor sensor;
    sensor.name = common.name;
    sensor.period_s = common.period_s;
    sensor.min_range_m = common.limits.min_m;
    sensor.max_range_m = common.limits.max_m;
    sensor.divergence_rad = common.divergence_rad;
    if (field.has_member("clockwise")) sensor.clockwise = field.at("clockwise").boolean();
    if (field.has_member("beams")) read_beams(field, sensor);
    // By default, the first column is half a column from the rear. Then the columns are
    // symmetric to the front.
    const double default_first_rad =
        sensor.columns > 0 ? (180.0 - 180.0 / sensor.columns) * kPi / 180.0 : 0.0;
    sensor.first_azimuth_rad = read_angle_or_rad(field, "first_azimuth", default_first_rad, kMaxAngle_deg);
    sensor.azimuth_rad = read_azimuths(field);
    return {.name = common.name, .limits = common.limits, .pattern = std::move(sensor)};
}

/// Writes the members that parse_spinning() reads. Leaves out name and range limits.
nlohmann::ordered_json sensor::write(const SpinningSensor& sensor) {
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

ScanPatternSummary sensor::describe(const SpinningSensor& sensor) {
    return {.n_rays = sensor.beams.size() * fired_columns(sensor).size(), .period_s = sensor.period_s};
}

}  // namespace relidar
