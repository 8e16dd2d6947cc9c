// SPDX-License-Identifier: Apache-2.0
// Checks whether a device adds floats and runs subgroup operations correctly. Compares
// the device's results with exact results of the host.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <relidar/gpu/device.hpp>

namespace relidar {

/// Lets many threads add small integers to a few sums on the device.
/// @param swaps true: adds with compare-and-swap. false: adds with float atomics, which
/// the device must support
/// @return the largest relative error of a sum. 0 if all sums are correct
double compute_sum_error(Device& device, bool swaps);

/// Tests atomic addition with compare-and-swap. The threads of one dispatch add numbers
/// to 1024 shared sums.
/// @return the largest relative error, compared with the exact sums
/// @param seconds receives the duration of the dispatch
double measure_sum_error_of_kernel(Device& device, std::uint32_t n_threads, double& seconds);

/// Returns the subgroup sizes that kernels can request, of 4 to 64 lanes.
std::vector<int> list_subgroup_sizes(const Device& device);

/// Checks subgroup operations with DeviceInfo::get_subgroup_size lanes per subgroup. Also
/// checks a sort that uses subgroup operations.
/// @return a text with the first wrong result and the expected result. Empty if all
/// results are correct
std::string find_wrong_subgroups(Device& device);

}  // namespace relidar
