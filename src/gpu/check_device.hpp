// SPDX-License-Identifier: Apache-2.0
// Checks whether a device adds floats and runs subgroup operations correctly. Compares
// the device's results with exact results of the host.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <relidar/gpu/device.hpp>

namespace relidar {

/// Tests atomic additions: many threads add small integers to a few sums on the device.
/// @param use_compare_and_swap true: adds with compare-and-swap. false: adds with float
/// atomics, which the device must support
/// @return the largest relative error of a sum. 0 if all sums are right
double test_atomic_adds_and_get_max_error(Device& device, bool use_compare_and_swap);

/// Tests atomic additions with compare-and-swap, for a given number of threads that add
/// to 1024 sums.
/// @return the largest relative error of a sum
/// @param elapsed_s receives the duration of the dispatch
double test_compare_and_swap_adds_and_get_max_error(Device& device, std::uint32_t n_threads,
                                                    double& elapsed_s);

/// Returns the subgroup sizes that kernels can request, of 4 to 64 lanes.
std::vector<int> list_requestable_subgroup_sizes(const Device& device);

/// Tests subgroup operations with DeviceInfo::subgroup_size lanes per subgroup. Also
/// tests a sort that uses these operations.
/// @return text about the first wrong result. Empty if all results are right
std::string test_subgroups_and_describe_error(Device& device);

}  // namespace relidar
