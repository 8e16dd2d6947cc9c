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
struct FiringPlace {
    double azimuth_deg, time_s;
    int number;  ///< number of the firing; for a sensor that fires at fixed azimuths, the column
    /// current minus average rotation rate of the head, in degrees per microsecond
    double ahead_deg_us;
    double brightness;  ///< intensity value that becomes 1
};

/// Points of a revolution.
struct FiredPoints {
    Points points;
    std::vector<int> numbers;        ///< [points] number of the firing that measured the point
    std::map<int, double> head_rad;  ///< azimuth of each received firing, by its number
};

/// Converts the returns of a firing to points. If a ray has two returns, the brighter one
/// is the first return.
void add_firing(FiredPoints& fired, const FiringPlace& place, const std::array<Echo, 2>* echoes,
                const std::vector<BeamGeometry>& beams, const std::vector<double>& offset_us);

/// Creates the scan of a sensor that fires at fixed azimuths. If the sensor did not
/// measure in a long run of columns, their rays are dropped rays. Otherwise, the scan
/// would repeat a neighbouring column, which would be wrong data.
/// @param fires  [columns per revolution] true if the sensor fires at the column
/// @param is_lost  [columns per revolution] true if the packet with the column was lost.
/// Its rays are unknown, so the scan does not have them.
Scan make_fired_scan(FiredPoints& fired, const std::vector<bool>& fires, const std::vector<bool>& is_lost,
                     SpinningSensor sensor);

}  // namespace relidar::packets
