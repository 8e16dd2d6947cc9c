// SPDX-License-Identifier: Apache-2.0
// Points of the firings of a revolution.
#pragma once

#include <array>
#include <map>
#include <vector>

#include <relidar/log/clouds.hpp>

#include "log/readers/bag/packets/decoder.hpp"
#include "log/sensor/beam_geometry.hpp"

namespace relidar::packets {

/// Azimuth, time and number of a firing (all lasers at one azimuth).
struct FiringInstant {
    double azimuth_deg, time_s;
    int number;  ///< number of the firing; for a sensor that fires at fixed azimuths, the column
    /// current minus mean rotation rate of the LiDAR's head, in degrees per microsecond
    double ahead_deg_us;
    double brightness;  ///< intensity value that becomes 1
};

struct RevolutionPoints {
    LidarPoints points;
    std::vector<int> numbers;        ///< [points] number of the firing that measured the point
    std::map<int, double> head_rad;  ///< azimuth of each received firing, by its number
};

/// Converts the returns of a firing to points. If a ray has two returns, the brighter one
/// is the first return.
void add_points_of_firing(RevolutionPoints& revolution_points, const FiringInstant& firing,
                          const std::array<DecodedReturn, 2>* returns_of_each_ring,
                          const std::vector<BeamRayGenerator>& beams,
                          const std::vector<double>& beam_offsets_us);

/// Creates the scan of a sensor that fires at fixed azimuths. If many consecutive columns
/// were not measured, their rays become dropped rays. Otherwise the scan would repeat a
/// neighbouring column there, which would be wrong data.
/// @param column_is_enabled  [columns per revolution] true if the sensor fires at the
/// column
/// @param column_is_lost  [columns per revolution] true if the packet with the column
/// was lost. Its rays are unknown, so the scan does not contain them.
Scan make_scan_of_fixed_azimuth_sensor(RevolutionPoints& revolution_points,
                                       const std::vector<bool>& column_is_enabled,
                                       const std::vector<bool>& column_is_lost, SpinningSensor sensor);

}  // namespace relidar::packets
