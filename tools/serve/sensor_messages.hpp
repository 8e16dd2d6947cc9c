// SPDX-License-Identifier: Apache-2.0
// Checks every value of a sensor before its rays are computed.
#pragma once

#include <string>

#include <relidar/simulate/render.hpp>

#include "relidar/v1/render.pb.h"

namespace relidar::serve {

/// A CPU needs seconds even for a scan of this size.
inline constexpr std::size_t kMostRaysOfScan = std::size_t(1) << 20;

SimulatedSensor read_sensor(const v1::SensorSpec& message, const std::string& name);

/// "native" and "" mean the sensor of the log. File names are rejected, because clients
/// must not read files of the server.
/// @throws RejectedRequest if the name is unknown or the sensor has too many rays
SimulatedSensor find_known_sensor(const std::string& sensor_name_or_native, const Run& run, int lidar);

/// In seconds relative to the time of the scan.
struct FiringTimeSpan {
    double first_s = 0.0, last_s = 0.0;
};
FiringTimeSpan firing_span(const SimulatedSensor& sensor);

std::size_t count_rays(const SimulatedSensor& sensor);

}  // namespace relidar::serve
