// SPDX-License-Identifier: Apache-2.0
// Decides which methods of a device give correct results, from the results of a device
// check. The results are stored next to the pipeline cache.
#pragma once

#include <filesystem>
#include <string>

#include <relidar/gpu/trust.hpp>

#include "gpu/context.hpp"

namespace relidar::gpu {

/// Returns the results of the device check. Reads the results from the cache folder if a
/// valid file exists. Runs the check if the file is missing, damaged, or from another
/// version of the driver or of relidar. If the results cannot be stored in a file, they
/// are kept in memory until the process ends. If the program has set no check, every
/// method counts as correct.
DeviceTestResults read_or_run_device_test(const Device::Impl& device, const DeviceOptions& options);

/// Prints a line about devices, unless this thread has fixed test results.
void report_device_note(const std::string& text);
/// Replaces the methods that failed the device test by other methods, and prints one line
/// for each. Call this function before the device is opened.
void disable_methods_that_failed_test(Device::Impl& device, const DeviceTestResults& test_results);

/// Makes parts of the device test fail, for tests. The names are separated by commas:
/// float_atomics, float_swaps, subgroups:N, ray_query. In builds with RELIDAR_ASSERTS,
/// apply_environment_variables() reads them from RELIDAR_FAULTS.
void set_injected_faults(const std::string& comma_separated_faults);
bool is_fault_injected(const std::string& fault_name);

}  // namespace relidar::gpu
