// SPDX-License-Identifier: Apache-2.0
// How fast a device copies memory, for benchmarks.
#pragma once

#include <optional>

namespace relidar {

class Device;

/// Bytes a second that a copy on the device reads and writes together: the best of
/// several copies of 256 MiB, which no cache can hold. Copies less if memory is short.
/// @return nothing if not even 1 MiB is free
std::optional<double> copy_bytes_per_s(Device& device);

}  // namespace relidar
