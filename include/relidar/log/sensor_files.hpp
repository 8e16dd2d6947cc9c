// SPDX-License-Identifier: Apache-2.0
// Reads sensors and sensor rigs from files. All commands use these functions to find the
// sensor that a user has named.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/base/math.hpp>
#include <relidar/log/sensor.hpp>

namespace relidar {

/// Maximum range of a simulated sensor if its file does not specify one.
inline constexpr double kDefaultMaxRange_m = 80.0;

/// Returns a sensor by name, or reads it from a file. For a spinning sensor,
/// ":columns[xHz]" may follow, as in "beams.csv:1024x10".
///   NAME       a name of sensor_names(), in upper or lower case
///   FILE.csv   a beam table, see parse_beam_table(); or a ray table: a line for each
///              ray in the order of firing. Columns azimuth_deg (left is positive) and
///              elevation_deg; if they are not 0, also origin_x_m, origin_y_m, origin_z_m,
///              time_s, channel and divergence_mrad (full angle of the beam). min_range_m
///              and max_range_m have the same value in each line.
///   FILE.npz   a ray table with the names of a rendered scan: directions [n,3] or
///              [rows,columns,3], origin, time, ring, and divergence (radians, of each ray)
///              or divergence_mrad (of all rays)
///   FILE.json  one of four things:
///              a ray table, as lists with the same names, and min_range_m, max_range_m;
///              the metadata file of an Ouster sensor, in the old or new format: beam
///              angles, beam origin offset, columns and rate;
///              {"window": {rows, columns, left_deg, right_deg, top_deg, bottom_deg}};
///              {"rosette": {rays, deflection_deg, first_hz, second_hz}}.
///              A window and a rosette also have period_s (0.1), divergence_mrad,
///              min_range_m and max_range_m (defaults 0, 0, 80).
/// @param also_known  further names that the caller accepts, for the error message
/// @param max_range_m  maximum range if the file does not specify one
/// @throws UsageError for an unknown name; the message suggests the most similar known
/// name
/// @throws DataError for an invalid file
SensorModel find_sensor(const std::string& name_or_file, const std::vector<std::string>& also_known = {},
                        double max_range_m = kDefaultMaxRange_m);

/// Returns the sensor that the text of a JSON file describes.
/// @param name  name of the sensor
/// @param where  name of the text in error messages
/// @throws DataError if the text is not a valid sensor
SensorModel sensor_of_json(const std::string& text, const std::string& name, const std::string& where);

/// A sensor of a rig, with its mounting.
struct MountedSensor {
    std::string name;
    SensorModel sensor;
    Pose rig_from_sensor;
    int returns = 1;  ///< returns of a ray, 1 or 2
};

/// Reads the sensors of a rig from a JSON file that has the key "sensors". Returns
/// nothing if the path is not such a file or cannot be read.
///   {"sensors": [{"name": "front", "sensor": "VLP-16", "translation_m": [1, 0, 2],
///                 "yaw_pitch_roll_deg": [90, 0, 0]}, ...]}
/// - "name": the name of the sensor's output folder: letters, digits, -, _ and . Each
///   name is used once.
/// - "sensor": an argument of find_sensor(). Relative file names start at the folder of
///   the rig's file.
/// - "translation_m", "yaw_pitch_roll_deg": mounting, default 0. x forward, y left, z up;
///   yaw is applied first and is positive to the left.
/// - "returns": 2 for a sensor with two returns.
/// @throws DataError naming the sensor and the key that is wrong, or an error of
/// find_sensor()
std::optional<std::vector<MountedSensor>> find_rig(const std::string& path);

/// Help text for users about the formats of sensor files.
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
