// SPDX-License-Identifier: Apache-2.0
// Reads sensors from Protobuf messages. Clients are not trusted, so every value is
// checked before rays are made.
#pragma once

#include <string>

#include <relidar/simulate/render.hpp>

#include "relidar/v1/render.pb.h"

namespace relidar::serve {

/// Maximum number of rays of a scan. Larger scans are rejected, because even a scan of
/// this size takes seconds on a CPU.
inline constexpr std::size_t kMostRaysOfScan = std::size_t(1) << 20;

/// Reads the description of a sensor.
/// @param field name of the field in the request, used in error messages
/// @throws Refusal that names an invalid field
SensorChoice read_sensor(const v1::SensorSpec& message, const std::string& field);

/// Returns the sensor of the log for the name "native", or else a built-in sensor. File
/// names are rejected, because clients must not read files of the server.
/// @param run run without surfels
/// @throws Refusal if the name is unknown or the sensor has too many rays
SensorChoice named_sensor(const std::string& name, const Run& run, int lidar);

/// Firing times of the first and the last ray of a scan, in seconds relative to the time
/// of the scan.
struct FiringSpan {
    double first_s = 0.0, last_s = 0.0;
};
FiringSpan firing_span(const SensorChoice& sensor);

/// Returns the number of rays of one scan.
std::size_t count_rays(const SensorChoice& sensor);

}  // namespace relidar::serve
