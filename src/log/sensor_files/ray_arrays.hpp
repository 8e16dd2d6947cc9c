// SPDX-License-Identifier: Apache-2.0
// Reads ray tables from files. The columns of a table have the same names as the arrays
// of a rendered scan.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/log/sensor.hpp>

namespace relidar::sensor_files {

/// Ray table of a CSV, JSON or npz file. Arrays that the file does not contain are empty.
struct RayFileArrays {
    int rows = 1, columns = 0;
    std::vector<double> direction;  ///< [n,3] directions
    std::vector<double> origin;     ///< [n,3] origins in metres; empty: 0
    std::vector<double> time_s;     ///< [n] firing times; empty: 0
    std::vector<double> channel;    ///< [n] beam numbers; empty: 0
    /// [n] beam divergences, or one value for all rays; empty: 0
    std::vector<double> divergence_rad = {};
    RangeLimits limits = {};
    /// If true, directions that already have unit length are not normalised again,
    /// because that could change their last digits. So rays that relidar wrote are read
    /// back exactly.
    bool keeps_floats = false;
};

/// Checks rays and creates a sensor from them.
/// @param error_location  name of the file in error messages
/// @throws DataError if the arrays have different lengths, values are not finite or out
/// of range, or directions do not have unit length
SensorModel make_sensor_from_ray_arrays(const RayFileArrays& ray_arrays, const std::string& sensor_name,
                                        const std::string& error_location);

/// Returns the beam divergences in radians. A file may contain one number per ray or one
/// number for all rays.
/// @param ray_divergence_rad  [n] divergence of each ray, or empty
/// @throws DataError if the file contains both forms
std::vector<double> select_per_ray_or_common_divergence(std::vector<double> ray_divergence_rad,
                                                        std::optional<double> common_divergence_mrad,
                                                        const std::string& error_location);

/// Parses the text of a ray table in CSV format.
/// @throws DataError naming the line and the value that is wrong
SensorModel parse_ray_csv(const std::string& csv_text, const std::string& sensor_name,
                          const std::string& error_location);
/// Reads a ray table from an npz file (a zip archive of NumPy arrays).
/// @throws DataError if the file is invalid
SensorModel read_ray_npz(const std::string& path, const std::string& sensor_name);
/// Parses a sensor in JSON format: a sensor pattern, a ray table, or the metadata of an
/// Ouster sensor.
/// @param columns_or_zero  if above 0, replaces the number of columns in Ouster metadata
/// @param rate_hz_or_zero  if above 0, replaces the rate in Ouster metadata
/// @throws DataError naming the key that is wrong
SensorModel parse_sensor_json(const std::string& json_text, const std::string& sensor_name,
                              const std::string& error_location, int columns_or_zero, double rate_hz_or_zero);

/// Sets the maximum range if the sensor has no maximum range.
/// @throws DataError if the maximum range is not above the minimum range
void set_max_range_if_missing(SensorModel& sensor, double max_range_m, const std::string& error_location);

}  // namespace relidar::sensor_files
