// SPDX-License-Identifier: Apache-2.0
// Measures the copy bandwidth of a device, for benchmarks.
#pragma once

#include <optional>

namespace relidar {

class Device;

/// Measures the memory bandwidth of a device. Returns the bytes per second that a copy
/// reads and writes in total. Takes the fastest of several copies of 256 MiB, which do
/// not fit into any cache. Copies less if memory is short.
/// @return nullopt if not even 1 MiB is free
std::optional<double> copy_bytes_per_s(Device& device);

}  // namespace relidar
