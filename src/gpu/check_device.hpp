// SPDX-License-Identifier: Apache-2.0
// Checks whether a device adds floats and runs subgroup operations correctly. Compares
// the device's results with exact results of the host.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <relidar/gpu/device.hpp>

namespace relidar {

/// Many threads add small integers to a few sums, with compare-and-swap or with float
/// atomics, which the device must support.
/// @return the largest relative error of a sum
double test_atomic_adds_and_get_max_error(Device& device, bool use_compare_and_swap);

/// Same with compare-and-swap and 1024 sums.
/// @param elapsed_s receives the duration of the dispatch
double test_compare_and_swap_adds_and_get_max_error(Device& device, std::uint32_t n_threads,
                                                    double& elapsed_s);

std::vector<int> list_requestable_subgroup_sizes(const Device& device);

/// Tests subgroup operations, and a sort that uses them.
/// @return text about the first wrong result, or an empty text
std::string test_subgroups_and_describe_error(Device& device);

}  // namespace relidar
