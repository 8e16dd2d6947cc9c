// SPDX-License-Identifier: Apache-2.0
// Sensors as files, and the one place where a user's word for a sensor becomes one.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/base/math.hpp>
#include <relidar/log/sensor.hpp>

namespace relidar {

/// Range of a simulated sensor whose file gives none.
inline constexpr double kDefaultMaxRange_m = 80.0;

/// A sensor by name or file, optionally followed by ":columns[xHz]" where it spins, as in
/// "beams.csv:1024x10".
///   NAME          of sensor_names(), in any case
///   FILE.csv      a beam table (parse_beam_table()), or a ray table: a line a ray in the order of firing, with the columns azimuth_deg
/// (left
///                 positive) and elevation_deg, and where they are not 0 origin_x_m, origin_y_m, origin_z_m, time_s, channel,
///                 divergence_mrad (full angle of the beam); the same in each line: min_range_m, max_range_m
///   FILE.npz      a ray table under the names of a rendered scan: directions [n,3] or [rows,columns,3], origin, time, ring; divergence
///                 (radians, of each ray) or divergence_mrad (of all)
///   FILE.json     a ray table, as lists under the same names, with min_range_m and max_range_m; or the metadata of an
///                 Ouster sensor as its own tools write it, old or new: beam angles, beam origin offset, columns and rate; or
///                 {"window": {rows, columns, left_deg, right_deg, top_deg, bottom_deg}} or {"rosette": {rays, deflection_deg, first_hz,
///                 second_hz}}, each with period_s (0.1) and divergence_mrad, min_range_m, max_range_m (0, 0, 80)
/// @param also_known  names that the caller knows beside sensor_names(), for the message
/// @param max_range_m  of a file that gives none
/// @throws UsageError for an unknown name (the nearest known one is named), DataError for
/// a bad file
SensorModel find_sensor(const std::string& name_or_file, const std::vector<std::string>& also_known = {},
                        double max_range_m = kDefaultMaxRange_m);

/// The sensor of what a FILE.json holds. @param name  of the sensor @param where  what
/// messages call the text @throws DataError
SensorModel sensor_of_json(const std::string& text, const std::string& name, const std::string& where);

/// A sensor of a rig.
struct MountedSensor {
    std::string name;
    SensorModel sensor;
    Pose rig_from_sensor;
    int returns = 1;  ///< of a ray, 1 or 2
};

/// The sensors of a rig, from JSON; nothing where the path is no rig's file: JSON with
/// "sensors". A file that cannot be read is none.
///   {"sensors": [{"name": "front", "sensor": "VLP-16", "translation_m": [1, 0, 2], "yaw_pitch_roll_deg": [90, 0, 0]}, ...]}
/// sensor is what find_sensor() takes, files beside the rig's; translation_m and
/// yaw_pitch_roll_deg (each 0 where left out) mount it, x forward, y left, z up, yaw to
/// the left first; "returns": 2 where it has two. Names are folders of files: letters,
/// digits, -, _ and ., each once.
/// @throws DataError naming the sensor and key that is wrong, or as find_sensor()
std::optional<std::vector<MountedSensor>> find_rig(const std::string& path);

/// What sensor files hold, in lines for a user.
inline constexpr const char* kSensorFileHelp =
    "NAME is one of `relidar list sensors`. A FILE holds a sensor of your own:\n"
    "  beams.csv   a spinning one: a header line, then a line for each beam, from the highest down, with the "
    "columns elevation_deg\n"
    "              (needed; up is positive), azimuth_offset_deg (from where the head points, to the left), "
    "origin_offset_m (where the\n"
    "              beam starts: along the head's direction), origin_up_m (at right angles to the beam, "
    "upwards), origin_left_m,\n"
    "              firing_offset_us, min_range_m, max_range_m (of the sensor; default 0, 80), channel (not "
    "used). Columns left out\n"
    "              are 0; any other is an error. beams.csv:1024x10 is 1024 columns a sweep at 10 Hz "
    "(default: 1800x10);\n"
    "              so are VLP-16:900x20 and other spinning sensors by name.\n"
    "  rays.csv    any other: a line for each ray with azimuth_deg, elevation_deg, and where they are not 0 "
    "origin_x_m, origin_y_m,\n"
    "              origin_z_m, time_s, channel, divergence_mrad (full angle of the beam); the same in each "
    "line: min_range_m,\n"
    "              max_range_m.\n"
    "  rays.npz    directions [n,3] or [rows,columns,3], origin, time, ring, as a rendered scan holds them; "
    "divergence (radians,\n"
    "              of each ray) or divergence_mrad (of all).\n"
    "  FILE.json   lists by the same names; an Ouster sensor's own metadata; or what sweeps: {\"window\": "
    "{rows, columns, left_deg,\n"
    "              right_deg, top_deg, bottom_deg}} or {\"rosette\": {rays, deflection_deg, first_hz, "
    "second_hz}}, with period_s,\n"
    "              divergence_mrad, min_range_m, max_range_m.\n"
    "  rig.json    several sensors: {\"sensors\": [{\"name\": \"front\", \"sensor\": \"VLP-16\", "
    "\"translation_m\": [1,0,2],\n"
    "              \"yaw_pitch_roll_deg\": [90,0,0], \"returns\": 1}, ...]}, mounted in the frame of the "
    "sensor they stand in for.";

}  // namespace relidar
