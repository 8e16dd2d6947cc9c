// SPDX-License-Identifier: Apache-2.0
// Checks whether a device adds floats and runs subgroup operations correctly. Compares
// the device's results with exact results of the host.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <relidar/gpu/device.hpp>

namespace relidar {

enum class AtomicAddMethod { float_atomics, compare_and_swap };

/// Many threads add small integers to a few sums. The device must support the method.
/// @return the largest relative error of a sum
double test_atomic_adds(Device& device, AtomicAddMethod method);

/// Same with compare-and-swap and 1024 sums.
/// @param elapsed_s receives the duration of the dispatch
double test_swap_adds(Device& device, std::uint32_t n_threads, double& elapsed_s);

std::vector<int> subgroup_sizes(const Device& device);

/// Tests subgroup operations, and a sort that uses them.
/// @return text about the first wrong result, or an empty text
std::string test_subgroups(Device& device);

}  // namespace relidar
