// SPDX-License-Identifier: Apache-2.0
// Sensors as clients send them. Whatever a client sends is looked at here, before rays
// are made of it.
#pragma once

#include <string>

#include <relidar/simulate/render.hpp>

#include "relidar/v1/render.pb.h"

namespace relidar::serve {

/// Of one scan of any sensor: a scan of so many takes seconds on a CPU.
inline constexpr std::size_t kMostRaysOfScan = std::size_t(1) << 20;

/// @param field  its name in the request, for messages @throws Refusal naming the field
/// that makes no sense
SensorChoice read_sensor(const v1::SensorSpec& message, const std::string& field);

/// A sensor by name: "native", or a built-in one. Never a file: clients have no business
/// with those of the server.
/// @param run  without surfels @throws Refusal for another name, or too many rays
SensorChoice named_sensor(const std::string& name, const Run& run, int lidar);

/// When the first or last ray of a sensor's scan is fired, seconds from the scan's time.
struct FiringSpan {
    double first_s = 0.0, last_s = 0.0;
};
FiringSpan firing_span(const SensorChoice& sensor);

/// Of one scan.
std::size_t count_rays(const SensorChoice& sensor);

}  // namespace relidar::serve
