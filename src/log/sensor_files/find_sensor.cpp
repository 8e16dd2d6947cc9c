// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/sensor_files.hpp>

#include <array>
#include <cmath>
#include <optional>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/base/error.hpp>
#include <relidar/log/sensor_pattern.hpp>
#include "base/fail.hpp"
#include "base/files.hpp"
#include "log/sensor_files/ray_arrays.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

constexpr double kMaxColumns = 1'000'000, kMaxRate_hz = 10'000;
constexpr sensor_files::SpinMode kTableMode{.columns = 1800, .rate_hz = 10.0};

/// Azimuths of the first and the last ray of a turn, radians.
using Azimuths = std::array<double, 2>;

/// Parts of "OS1-64:1024x10:60..-60".
struct SensorSpecifier {
    std::string name;
    std::optional<sensor_files::SpinMode> mode = {};
    std::optional<Azimuths> azimuth_rad = {};
};

/// Parses a field of view such as "60..-60". Returns nothing for other texts.
std::optional<Azimuths> parse_azimuths(std::string_view suffix, const std::string& specifier_text) {
    const std::size_t dots = suffix.find("..");
    if (dots == std::string::npos) return {};
    const auto first_deg = parse_number(suffix.substr(0, dots)),
               last_deg = parse_number(suffix.substr(dots + 2));
    if (!first_deg || !last_deg) return {};
    const double largest_deg = std::max(std::abs(*first_deg), std::abs(*last_deg));
    if (!(largest_deg <= 360.0) || *first_deg == *last_deg)
        fail<UsageError>(
            "sensor '{}': found azimuths from {} to {} degrees, expected two different numbers from -360 to "
            "360",
            specifier_text, *first_deg, *last_deg);
    return Azimuths{*first_deg * kPi / 180.0, *last_deg * kPi / 180.0};
}

/// Parses columns and rate such as "1024x20", or only columns. Returns nothing for other
/// texts.
std::optional<sensor_files::SpinMode> parse_mode(std::string_view suffix, const std::string& specifier_text) {
    const std::size_t x = std::min(suffix.find('x'), suffix.size());
    const auto columns = parse_number(suffix.substr(0, x));
    std::optional<double> rate_hz = kTableMode.rate_hz;
    if (x < suffix.size()) rate_hz = parse_number(suffix.substr(x + 1));
    if (!columns || !rate_hz) return {};
    const bool is_column_count =
        *columns >= 1.0 && *columns <= kMaxColumns && *columns == std::floor(*columns);
    const bool is_rate = *rate_hz > 0.0 && *rate_hz <= kMaxRate_hz;
    if (!is_column_count || !is_rate)
        fail<UsageError>(
            "sensor '{}': found {} columns at {} Hz, expected 1 to {} columns and a rate above 0 and up to "
            "{} Hz",
            specifier_text, *columns, *rate_hz, kMaxColumns, kMaxRate_hz);
    return sensor_files::SpinMode{int(*columns), *rate_hz};
}

/// Separates the name of a sensor or a file from the optional mode and field of view.
/// Other colons are part of a file path.
/// @throws UsageError if a number is out of range
SensorSpecifier parse_specifier(const std::string& text) {
    SensorSpecifier specifier{text};
    const auto cut_suffix = [&](auto& value, const auto& parse) {
        const std::size_t colon = specifier.name.rfind(':');
        if (colon == std::string::npos || colon == 0) return;
        value = parse(std::string_view(specifier.name).substr(colon + 1), text);
        if (value) specifier.name.resize(colon);
    };
    cut_suffix(specifier.azimuth_rad, parse_azimuths);
    cut_suffix(specifier.mode, parse_mode);
    return specifier;
}

/// Reads a file whose format is not JSON or npz: a table of beams or of rays.
SensorModel parse_csv_sensor(const std::string& csv_text, const SensorSpecifier& specifier) {
    const std::string stem = fs::path(specifier.name).stem().string();
    // Only a table of rays has this column.
    const std::string header = csv_text.substr(0, csv_text.find('\n'));
    if (header.find("azimuth_deg") != std::string::npos)
        return sensor_files::parse_ray_csv(csv_text, stem, specifier.name);
    const auto [columns, rate_hz] = specifier.mode.value_or(kTableMode);
    SpinningSensor sensor = parse_beams(csv_text, specifier.name, columns, rate_hz);
    sensor.name = stem;
    return {.name = stem, .limits = sensor.range_limits(), .pattern = std::move(sensor)};
}

/// Reads a sensor from a file. The extension determines the format.
/// @param default_max_range_m  maximum range if the file contains none
SensorModel read_sensor_file(const SensorSpecifier& specifier, double default_max_range_m) {
    const fs::path path = specifier.name;
    const std::string stem = path.stem().string();
    SensorModel sensor;
    if (path.extension() == ".npz") sensor = sensor_files::read_ray_npz(specifier.name, stem);
    else if (path.extension() == ".json") {
        const nlohmann::json json = parse_json(read_text_file(path), specifier.name);
        sensor = sensor_files::read_json_sensor({json, specifier.name, ""}, stem, specifier.mode);
    } else sensor = parse_csv_sensor(read_text_file(path), specifier);
    if (specifier.mode && !std::holds_alternative<SpinningSensor>(sensor.pattern))
        fail<UsageError>(
            "sensor '{}:{}': the file describes a sensor that does not spin, so it accepts no number of "
            "columns; use only the file name",
            specifier.name, specifier.mode->columns);
    sensor_files::set_missing_range(sensor, default_max_range_m, specifier.name);
    return sensor;
}

}  // namespace

void sensor_files::set_missing_range(SensorModel& sensor, double max_range_m, const std::string& where) {
    if (!std::isinf(sensor.limits.max_m)) return;
    if (!(sensor.limits.min_m < max_range_m))
        fail(
            "{}: min_range_m is {} m, but max_range_m is not given and has the default value of {} m; "
            "expected min_range_m < max_range_m; give a larger max_range_m",
            where, sensor.limits.min_m, max_range_m);
    sensor.limits.max_m = max_range_m;
    if (auto* spinning = std::get_if<SpinningSensor>(&sensor.pattern)) spinning->max_range_m = max_range_m;
}

SensorModel parse_sensor(const std::string& text, const std::string& name, const std::string& where) {
    const nlohmann::json json = parse_json(text, where);
    return sensor_files::read_json_sensor({json, where, ""}, name);
}

SensorModel find_sensor(const std::string& name_or_file, const std::vector<std::string>& other_known_names,
                        double default_max_range_m) {
    const SensorSpecifier specifier = parse_specifier(name_or_file);
    const auto with_azimuths = [&](SensorModel sensor) {
        auto* spinning = std::get_if<SpinningSensor>(&sensor.pattern);
        if (specifier.azimuth_rad && !spinning)
            fail<UsageError>(
                "sensor '{}': found a field of view, expected none, because the sensor does not spin",
                name_or_file);
        if (specifier.azimuth_rad) spinning->azimuth_rad = specifier.azimuth_rad;
        return sensor;
    };
    // Built-in names take precedence over files.
    const auto [columns, rate_hz] = specifier.mode.value_or(sensor_files::SpinMode{});
    if (const auto built_in_sensor = find_built_in(specifier.name, columns, rate_hz))
        return with_azimuths(*built_in_sensor);
    const std::string extension = fs::path(specifier.name).extension().string();
    if (extension == ".csv" || extension == ".json" || extension == ".npz" || does_path_exist(specifier.name))
        return with_azimuths(read_sensor_file(specifier, default_max_range_m));
    std::vector<std::string> known_names = other_known_names;
    for (const std::string& sensor : list_sensors()) known_names.push_back(sensor);
    fail<UsageError>(
        "the sensor '{}' is unknown{} (known: {}; or the path of a file, such as beams.csv:1024x10, rays.npz "
        "or the metadata.json of an Ouster sensor)",
        name_or_file, did_you_mean(name_or_file, known_names, "'"), fmt::join(known_names, ", "));
}

std::string sensor_file_help() {
    return R"(NAME is one of `relidar list sensors`. A FILE contains a custom sensor:
  beams.csv   a spinning sensor: a header line, then one line per beam, from the highest to the lowest. Columns: elevation_deg
              (required; up is positive), azimuth_offset_deg (relative to the head, positive to the left), origin_offset_m
              (start of the beam along the head direction), origin_up_m (perpendicular to the beam, upwards), origin_left_m,
              firing_offset_us, min_range_m and max_range_m (same for all beams; default 0 and 80), channel (ignored).
              Missing columns are 0; unknown columns are an error. beams.csv:1024x10 means 1024 columns per sweep at 10 Hz
(default: 1800x10). The names of spinning sensors accept the same suffix, for example VLP-16:900x20.
              :60..-60 at the end of a name is the field of view in the order of rotation.
  rays.csv    any other sensor: one line per ray with azimuth_deg, elevation_deg, and optionally origin_x_m, origin_y_m,
              origin_z_m, time_s, channel, divergence_mrad (full angle of the beam), min_range_m and max_range_m (the
              same in each line).
  rays.npz    directions [n,3] or [rows,columns,3], origin, time, ring, like in a rendered scan; divergence (radians,
              one value per ray) or divergence_mrad (one value for all rays).
  FILE.json   lists with the same names, the metadata of an Ouster sensor, or one of
)" + pattern_help() +
           R"(              each with name, period_s (0.1), divergence_mrad (0), min_range_m (0), max_range_m (80); defaults in parentheses.
              NAME_rad can be used instead of NAME_deg.
  rig.json    several sensors: {"sensors": [{"name": "front", "sensor": "VLP-16", "translation_m": [1,0,2],
              "yaw_pitch_roll_deg": [90,0,0], "returns": 1}, ...]}, mounted in the frame of the sensor that the rig replaces.
              "vehicle": {"length_m", "width_m", "height_m", "rear_axle_to_front_m", "base_link_m": [x,y,z] (rear axle on the
              ground), "boxes": [{"centre_m", "size_m"}] (default: one box), "points": "drop" or "ego"} blocks rays.)";
}

}  // namespace relidar
