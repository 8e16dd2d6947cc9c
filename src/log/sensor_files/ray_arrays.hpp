// SPDX-License-Identifier: Apache-2.0
// Reads ray tables from files. The columns of a table have the same names as the arrays
// of a rendered scan.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/log/sensor.hpp>

#include "base/json_field.hpp"

namespace relidar::sensor_files {

/// Arrays that the file does not contain are empty.
struct RayFileArrays {
    int rows = 1, columns = 0;
    std::vector<double> direction;  ///< [n,3] directions
    std::vector<double> origin;     ///< [n,3] origins in metres; empty: 0
    std::vector<double> time_s;     ///< [n] firing times; empty: 0
    std::vector<double> channel;    ///< [n] beam numbers; empty: 0
    /// [n], or one value for all rays; empty: 0
    std::vector<double> divergence_rad = {};
    RangeLimits limits = {};
    /// Directions of unit length are not normalised again, so that rays of relidar are
    /// read back exactly.
    bool keeps_floats = false;
};

/// Checks rays and creates a sensor from them.
/// @param where name of the file in error messages
/// @throws DataError for different lengths, for values out of range, and for directions
/// without unit length
SensorModel make_ray_sensor(const RayFileArrays& arrays, const std::string& name, const std::string& where);

/// @param ray_divergence_rad  [n] radians, or empty
/// @throws DataError if the file contains both forms
std::vector<double> choose_divergence(std::vector<double> ray_divergence_rad,
                                      std::optional<double> common_divergence_mrad, const std::string& where);

/// Parses the text of a ray table in CSV format.
/// @throws DataError naming the line and the value that is wrong
SensorModel parse_ray_csv(const std::string& csv_text, const std::string& name, const std::string& where);
/// Reads a ray table from an npz file (a zip archive of NumPy arrays).
SensorModel read_ray_npz(const std::string& path, const std::string& name);

/// Columns and rate of a spinning sensor.
struct SpinMode {
    int columns = 0;
    double rate_hz = 0.0;
};
/// Reads a pattern, a ray table, or the metadata of an Ouster.
/// @param name  used if the object contains none
/// @param ouster_mode  replaces the mode in the metadata of an Ouster
/// @throws DataError naming the key that is wrong
SensorModel read_json_sensor(const JsonField& object, const std::string& name,
                             const std::optional<SpinMode>& ouster_mode = {});

/// Sets the maximum range of a sensor whose file has none. The parser has set it to
/// infinity in this case.
/// @throws DataError if the maximum range is not above the minimum range
void set_missing_range(SensorModel& sensor, double max_range_m, const std::string& where);

}  // namespace relidar::sensor_files
