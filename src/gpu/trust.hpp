// SPDX-License-Identifier: Apache-2.0
// Finds out which methods of a device relidar trusts. The results of the check are stored
// next to the pipeline cache.
#pragma once

#include <filesystem>
#include <string>

#include <relidar/gpu/trust.hpp>

#include "gpu/context.hpp"

namespace relidar::gpu {

/// Returns the results of the check of a device. Reads them from the cache folder. Runs
/// the check if the file is missing, damaged, or from another driver or another version
/// of relidar. Trusts everything if the program has set no check.
DeviceTrust find_trust(const Device::Impl& device, const DeviceOptions& options);

/// Replaces the methods that gave wrong results, and prints a line for each. Must be
/// called before the device is opened.
void distrust(Device::Impl& device, const DeviceTrust& trust);

/// Sets the checks that a test makes fail, separated by commas: float_atomics,
/// float_swaps, subgroups:N, ray_query. from_environment() sets them from RELIDAR_FAULTS
/// in builds with RELIDAR_ASSERTS.
void set_faults(const std::string& faults);
bool has_fault(const std::string& fault);

}  // namespace relidar::gpu
