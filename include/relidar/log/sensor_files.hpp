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
///                 {"<kind>": {...}} as read_sensor_json() reads it
/// @param also_known  names that the caller knows beside sensor_names(), for the message
/// @param max_range_m  of a file that gives none
/// @throws UsageError for an unknown name (the nearest known one is named), DataError for
/// a bad file
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

/// The sensors of a rig, from JSON; nothing where the path is no rig's file: JSON with
/// "sensors". A file that cannot be read is none.
///   {"sensors": [{"name": "front", "sensor": "VLP-16", "translation_m": [1, 0, 2], "yaw_pitch_roll_deg": [90, 0, 0]}, ...]}
/// sensor is what find_sensor() takes, files beside the rig's, or the object of a
/// FILE.json; translation_m and
/// yaw_pitch_roll_deg (each 0 where left out) mount it, x forward, y left, z up, yaw to
/// the left first; "returns": 2 where it has two. Names are folders of files: letters,
/// digits, -, _ and ., each once.
/// @throws DataError naming the sensor and key that is wrong, or as find_sensor()
std::optional<std::vector<MountedSensor>> find_rig(const std::string& path);

/// What sensor files hold, in lines for a user.
std::string sensor_file_help();

}  // namespace relidar
