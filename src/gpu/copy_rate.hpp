// SPDX-License-Identifier: Apache-2.0
// Measures the copy bandwidth of a device, for benchmarks.
#pragma once

#include <optional>

namespace relidar {

class Device;

/// Returns the number of bytes per second that a copy on the device reads and writes in
/// total. Takes the best of several copies of 256 MiB, which do not fit in any cache.
/// Uses less if memory is short.
/// @return nullopt if not even 1 MiB is free
std::optional<double> copy_bytes_per_s(Device& device);

}  // namespace relidar
