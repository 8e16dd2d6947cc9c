// SPDX-License-Identifier: Apache-2.0
// Decides which methods of a device give correct results, from the results of a device
// check. The results are stored next to the pipeline cache.
#pragma once

#include <relidar/gpu/trust.hpp>

#include "gpu/context.hpp"

namespace relidar::gpu {

/// Reads the results of the device check from the cache folder, or runs the check if the
/// file is missing, damaged, or from another version of the driver or of relidar. If the
/// program has set no check, every method counts as correct.
DeviceTestResults check_results(const Device::Impl& device, const DeviceOptions& options);

/// Prints a line about devices, unless this thread has fixed test results.
void report_note(const std::string& text);
void disable_failed(Device::Impl& device, const DeviceTestResults& results);

/// For tests: float_atomics, float_swaps, subgroups:N, ray_query. In builds with
/// RELIDAR_ASSERTS, apply_environment() reads them from RELIDAR_FAULTS.
void inject_faults(const std::string& comma_separated_faults);
bool has_fault(const std::string& fault_name);

}  // namespace relidar::gpu
