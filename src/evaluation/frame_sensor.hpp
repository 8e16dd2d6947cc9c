// SPDX-License-Identifier: Apache-2.0
// The sensor whose simulated scan is compared with a real one.
#pragma once

#include <relidar/render.hpp>
#include <relidar/sequence.hpp>

namespace relidar {

/// What config.sensor says, with the native grid on the rays of the scan itself. @param frame  with its scan
SensorChoice sensor_of_frame(const Config& config, const Sequence& sequence, const Frame& frame);

}  // namespace relidar
