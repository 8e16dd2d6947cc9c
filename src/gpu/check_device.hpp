// SPDX-License-Identifier: Apache-2.0
// Checks of float sums and subgroup operations. The host knows the right results exactly.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <relidar/gpu/device.hpp>

namespace relidar {

/// Adds many small integers to few sums on the device.
/// @param swaps true: checks compare-and-swap. false: checks the float atomics of the
/// device, which it must have
/// @return the largest error of a sum, divided by the right sum. 0 if all sums are right
double sum_error(Device& device, bool swaps);

/// Adds to 1024 sums by compare-and-swap with this number of threads in one dispatch.
/// @return the largest error of a sum, divided by the right sum
double sum_error_of(Device& device, std::uint32_t n_threads);

/// Returns the subgroup sizes that kernels can request, of 4 to 64 lanes.
std::vector<int> subgroup_sizes(const Device& device);

/// Checks subgroup operations and a sort with subgroups of DeviceInfo::subgroup_size
/// lanes.
/// @return the first wrong result and the expected result. Empty if all results are right
std::string wrong_subgroups(Device& device);

}  // namespace relidar
