// SPDX-License-Identifier: Apache-2.0
// Measures the copy bandwidth of a device, for benchmarks.
#pragma once

#include <optional>

namespace relidar {

class Device;

/// Bytes read plus bytes written per second. Uses the fastest of several copies of 256
/// MiB, which is larger than any cache, or less if memory is short.
/// @return nullopt if less than 1 MiB is free
std::optional<double> measure_bandwidth(Device& device);

}  // namespace relidar
