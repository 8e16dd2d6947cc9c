// SPDX-License-Identifier: Apache-2.0
// Measures how fast a device copies memory, for benchmarks.
#pragma once

#include <optional>

namespace relidar {

class Device;

/// Returns the bytes that a copy on the device reads and writes per second. Takes the
/// fastest of several copies of 256 MiB, which exceed every cache. Copies fewer bytes if
/// memory is short.
/// @return nothing if less than 1 MiB is free
std::optional<double> copy_bytes_per_s(Device& device);

}  // namespace relidar
