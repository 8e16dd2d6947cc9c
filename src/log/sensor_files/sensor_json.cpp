// SPDX-License-Identifier: Apache-2.0
// Reads sensors in JSON format: a sensor pattern, a ray table, or the metadata of an
// Ouster sensor. Ouster's metadata has an old flat form and a newer nested form. The x
// axis of Ouster's LiDAR frame points backward, to the connector. The sensor frame of
// relidar is this frame, rotated by 180 degrees about z. For column m of W, beam azimuth
// a and origin offset n:
//   head azimuth = pi - 2 pi m / W,   ray azimuth = head azimuth - a
// A ray starts at distance n from the axis, along the head direction.
#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>
#include <relidar/log/sensor_pattern.hpp>
#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/json_field.hpp"
#include "log/sensor/pattern_kinds.hpp"
#include "log/sensor_files/ray_arrays.hpp"

namespace relidar::sensor_files {
namespace {

constexpr std::size_t kMostBeams = 1024;

/// Returns a text of Ouster's metadata, or an empty text. The old form of the metadata is
/// flat, the newer form is nested.
std::string find_text(const JsonField& metadata, const char* key, const char* object) {
    const auto field = metadata.find(key, {object});
    return field && field->is_string() ? field->text() : "";
}

RangeLimits ouster_limits(const JsonField& metadata) {
    const std::string product = find_text(metadata, "prod_line", "sensor_info");
    const char* sensor_name = "OS1-128";
    if (product.starts_with("OS-0")) sensor_name = "OS0-128";
    else if (product.starts_with("OS-2")) sensor_name = "OS2-128";
    return find_built_in(sensor_name)->limits;
}

/// Reads the number of columns and the rate from the mode of an Ouster sensor. The mode
/// "1024x10" means 1024 columns at 10 Hz.
SpinMode parse_mode(const JsonField& metadata) {
    const std::string text = find_text(metadata, "lidar_mode", "config_params");
    const std::size_t x = std::min(text.find('x'), text.size());
    const auto columns = parse_number(text.substr(0, x)),
               rate_hz = parse_number(text.substr(std::min(x + 1, text.size())));
    const bool is_valid = columns && *columns >= 1 && *columns <= 65536 &&  //
                          rate_hz && *rate_hz > 0.0 && *rate_hz <= 1000.0;
    if (!is_valid)
        fail("{}: lidar_mode is \"{}\", expected columns and rate, for example \"1024x10\"",
             metadata.location(), quote(text));
    return {int(*columns), *rate_hz};
}

/// Reads the beams of an Ouster, and returns them from the highest to the lowest.
std::vector<Beam> parse_ouster_beams(const JsonField& metadata) {
    const std::string where = metadata.location();
    const auto read_list = [&](const char* key) {
        const auto numbers = metadata.find(key, {"beam_intrinsics"});
        return numbers ? numbers->numbers() : std::vector<double>{};
    };
    const std::vector<double> altitude = read_list("beam_altitude_angles"),
                              azimuth = read_list("beam_azimuth_angles");
    if (altitude.empty() || altitude.size() > kMostBeams || azimuth.size() != altitude.size())
        fail(
            "{}: found {} beam_altitude_angles and {} beam_azimuth_angles, expected the same number of both "
            "and at most {}",
            where, altitude.size(), azimuth.size(), kMostBeams);
    const auto offset_mm = metadata.find("lidar_origin_to_beam_origin_mm", {"beam_intrinsics"});
    const double offset_m = offset_mm ? 1e-3 * offset_mm->number() : 0.0;
    std::vector<Beam> beams;
    for (std::size_t b = 0; b < altitude.size(); ++b) {
        if (!(std::abs(altitude[b]) <= 90.0 && std::abs(azimuth[b]) <= 180.0 && std::abs(offset_m) < 1.0))
            fail(
                "{}: beam {} has altitude {} and azimuth {} and starts {} m from the axis, expected angles "
                "in degrees and less than 1 m",
                where, b, altitude[b], azimuth[b], offset_m);
        // Ouster counts azimuths clockwise, relidar to the left.
        beams.push_back({.elevation_rad = altitude[b] * kPi / 180.0,
                         .azimuth_offset_rad = -azimuth[b] * kPi / 180.0,
                         .origin_offset_m = offset_m});
    }
    std::ranges::stable_sort(beams, std::greater<>(), &Beam::elevation_rad);
    return beams;
}

/// Makes a spinning sensor from the metadata of an Ouster: beam angles, mode, product.
/// @param requested_mode  replaces the mode of the metadata
SensorModel parse_ouster(const JsonField& metadata, const std::string& name,
                         const std::optional<SpinMode>& requested_mode) {
    std::vector<Beam> beams = parse_ouster_beams(metadata);
    const auto [columns, rate_hz] = requested_mode ? *requested_mode : parse_mode(metadata);
    const RangeLimits limits = ouster_limits(metadata);
    return {.name = name,
            .limits = limits,
            .pattern = SpinningSensor{.name = name,
                                      .beams = std::move(beams),
                                      .columns = columns,
                                      .period_s = 1.0 / rate_hz,
                                      .first_azimuth_rad = kPi,  // The first column faces backward.
                                      .min_range_m = limits.min_m,
                                      .max_range_m = limits.max_m}};
}

}  // namespace

SensorModel read_json_sensor(const JsonField& object, const std::string& name,
                             const std::optional<SpinMode>& ouster_mode) {
    // A table of rays may be the object itself, without the key of its kind.
    if (object.has_member("directions")) return sensor::parse_ray_table(object, name);
    if (find_kind(object)) {
        SensorModel sensor = read_sensor_json(object, name);
        const auto* spinning = std::get_if<SpinningSensor>(&sensor.pattern);
        if (spinning && spinning->beams.empty())
            object.at("spinning").reject("found no beams", "expected at least one");
        return sensor;
    }
    if (object.find("beam_altitude_angles", {"beam_intrinsics"}))
        return parse_ouster(object, name, ouster_mode);
    std::string kinds;
    for (const PatternKind& kind : all_pattern_kinds()) kinds += fmt::format("\"{}\", ", kind.name);
    fail(
        "{}: found no sensor; expected a JSON object with one of the keys {}\"directions\" (a table of rays) "
        "or \"beam_altitude_angles\" (metadata of an Ouster)",
        object.location(), kinds);
}

}  // namespace relidar::sensor_files
