// SPDX-License-Identifier: Apache-2.0
// Reads sensors and sensor rigs from files. Commands call these functions to load the
// sensor that the user has selected by name or by file.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/base/math.hpp>
#include <relidar/log/own_vehicle.hpp>
#include <relidar/log/sensor.hpp>

namespace relidar {

/// Maximum range of a simulated sensor, used if the file of the sensor does not contain a
/// maximum range.
inline constexpr double kDefaultMaxRange_m = 80.0;

/// Returns a sensor by its name or from a file. For a spinning sensor, ":columns[xHz]"
/// may follow, for example "beams.csv:1024x10", and its field of view in degrees, for
/// example "VLP-16:60..-60" (SpinningSensor::azimuth_rad).
///   NAME       a name of list_sensors(), in upper or lower case
///   FILE.csv   a beam table (parse_beams()), or a ray table with a line for each
///              ray, in firing order. Columns of a ray table: azimuth_deg (positive to
///              the left), elevation_deg; optional, 0 by default: origin_x_m, origin_y_m,
///              origin_z_m, time_s, channel, divergence_mrad (full angle of the beam);
///              optional, with the same value in all lines: min_range_m, max_range_m
///   FILE.npz   a ray table with the array names of a rendered scan: directions [n,3]
///              or [rows,columns,3], origin, time, ring; divergence (radians, for each
///              ray) or divergence_mrad (for all rays)
///   FILE.json  one of three forms:
///              - a ray table as lists with the names of FILE.npz, and min_range_m,
///                max_range_m
///              - the metadata of an Ouster sensor in its old or new format (beam angles,
///                beam origin offset, columns and rate)
///              - {"<kind>": {...}} as read_sensor_json() reads it
/// @param other_known_names  additional names that the caller accepts, for the error
/// message
/// @param default_max_range_m  maximum range if the file does not contain one
/// @throws UsageError for an unknown name; the message suggests the most similar name
/// @throws DataError if the file is invalid
SensorModel find_sensor(const std::string& name_or_file,
                        const std::vector<std::string>& other_known_names = {},
                        double default_max_range_m = kDefaultMaxRange_m);

/// Returns the sensor that the text of a JSON file describes.
/// @param name  name of the sensor
/// @param where  name of the text in error messages
/// @throws DataError if the text is not a valid sensor
SensorModel parse_sensor(const std::string& text, const std::string& name, const std::string& where);

/// A sensor of a rig, with its mounting.
struct MountedSensor {
    std::string name;
    SensorModel sensor;
    Pose rig_from_sensor;
    int returns = 1;        ///< number of returns per ray, 1 or 2
    VehicleBody body = {};  ///< body of the rig's vehicle, in the frame of the sensor
};

/// Reads the sensors of a rig from a JSON file with the key "sensors". Returns nothing if
/// the file cannot be read or does not have this key.
///   {"sensors": [{"name": "front", "sensor": "VLP-16", "translation_m": [1, 0, 2],
///                 "yaw_pitch_roll_deg": [90, 0, 0]}, ...]}
/// "sensor" is an argument of find_sensor(), or an object with the content of a
/// FILE.json. File paths are relative to the rig's file. "translation_m" and
/// "yaw_pitch_roll_deg" are the mounting; the default is 0. The axes are x forward, y
/// left, z up. Yaw is the first rotation and is positive to the left. "returns" is 2 for
/// a sensor with two returns per ray. read_rig_vehicle() reads the key "vehicle". Sensor
/// names are also used as folder names, so they must be unique. They may contain letters,
/// digits, -, _ and dots.
/// @throws DataError naming the sensor and the key that is wrong
/// @throws errors of find_sensor()
std::optional<std::vector<MountedSensor>> read_sensor_rig(const std::string& path);

inline constexpr const char* kVehicleOfLog = "log";

/// Reads the own vehicle of a rig. Returns nothing if the file is not a rig or its rig
/// has no vehicle.
///   "vehicle": {"length_m": 4.5, "width_m": 1.8, "height_m": 1.5,
///               "rear_axle_to_front_m": 3.6, "base_link_m": [-1, 0, -1.8],
///               "boxes": [{"centre_m": [1.3, 0, 0.7], "size_m": [4.5, 1.8, 1]}],
///               "points": "drop"}
/// "base_link_m" is the position of base_link in the frame of the rig: the middle of the
/// rear axle on the ground. Boxes are in the frame base_link. Without "boxes", the body
/// is one box from the ground to the height. "points" is "drop" (default) or "ego".
/// "vehicle": "log" (kVehicleOfLog) is the body that the log's LiDAR sees, without boxes.
/// @throws DataError naming the key that is wrong
std::optional<OwnVehicle> read_rig_vehicle(const std::string& path);

/// Returns the help text for users about the formats of sensor files.
std::string sensor_file_help();

}  // namespace relidar
