// SPDX-License-Identifier: Apache-2.0
// Ray tables as files hold them: columns of numbers under the names of a rendered scan.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/log/sensor.hpp>

namespace relidar::sensor_files {

/// What a file says of its rays. Arrays that are empty were not given.
struct RayColumns {
    int rows = 1, columns = 0;
    std::vector<double> direction;            ///< [n,3]
    std::vector<double> origin;               ///< [n,3] metres; or not given: 0
    std::vector<double> time_s;               ///< [n]; or 0
    std::vector<double> channel;              ///< [n]; or 0
    std::vector<double> divergence_rad = {};  ///< [n], or one of all rays; or 0
    RangeLimits limits = {};
    /// Does not normalise directions that are floats of unit length, so that rays which
    /// relidar wrote read back to the same bits.
    bool keeps_floats = false;
};

/// The sensor of such rays. @param where  what messages call it
/// @throws DataError for arrays of other lengths, values that are not finite or beyond
/// all reach, directions that are not of unit length
SensorModel ray_sensor(const RayColumns& columns, const std::string& name, const std::string& where);

/// What RayColumns holds of divergence. @param of_rays_rad [n] or nothing @throws
/// DataError where both are given
std::vector<double> divergence_of(std::vector<double> of_rays_rad, std::optional<double> of_all_mrad,
                                  const std::string& where);

/// From the text of a CSV ray table. @throws DataError naming the line and the value that
/// is wrong
SensorModel parse_ray_csv(const std::string& text, const std::string& name, const std::string& where);
/// From an npz file. @throws DataError
SensorModel read_ray_npz(const std::string& path, const std::string& name);
/// From JSON: a ray table, or Ouster's metadata. @param columns @param rate_hz instead of
/// those in the metadata, where above 0
/// @throws DataError naming the key that is wrong
SensorModel parse_sensor_json(const std::string& text, const std::string& name, const std::string& where,
                              int columns, double rate_hz);

/// Sets the maximum range of a sensor that has none. @throws DataError unless it is above
/// the minimum range
void limit_range(SensorModel& sensor, double max_range_m, const std::string& where);

}  // namespace relidar::sensor_files
