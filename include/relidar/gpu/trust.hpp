// SPDX-License-Identifier: Apache-2.0
// Results of the check that a device passes when it is first used. Also declares the
// functions that request this check.
#pragma once

#include <functional>
#include <string>

#include <relidar/gpu/device.hpp>

namespace relidar {

/// Result of a check.
enum class Trust { unknown, right, wrong };

/// Results of the check at the first use of a device. They determine which methods
/// relidar uses on this device.
struct DeviceTrust {
    bool float_atomics = true;  ///< True if float atomics add correctly.
    bool float_swaps = true;    ///< True if compare-and-swap loops add correctly.
    /// Subgroup size with right results. 0 = the default of the driver.
    int subgroup_size = 0;
    /// States whether ray queries find the same surfels as a search without a tree.
    Trust ray_query = Trust::unknown;
};

/// Functions that Device calls when it opens a device.
struct FirstUse {
    /// Checks a device when it is first used with a driver version. The results are
    /// stored in the folder of the pipeline cache. Null = no check; all methods are
    /// trusted.
    std::function<DeviceTrust(const DeviceOptions&)> check;
    /// Receives a line of text for each method that relidar replaces. A method is
    /// replaced if the check found wrong results.
    std::function<void(const std::string&)> note;
};

/// Sets the functions for all devices that this process opens later. A program calls this
/// function once, before it opens a device. check_device_at_first_use() in
/// relidar/diff/first_use.hpp is the standard check.
void set_first_use(FirstUse first_use);

/// Scope object that replaces the check of devices. While the object exists, this thread
/// opens devices with the given results.
class Trusting {
public:
    explicit Trusting(const DeviceTrust& trust);
    ~Trusting();
    Trusting(const Trusting&) = delete;
    Trusting& operator=(const Trusting&) = delete;

private:
    const DeviceTrust* before_;
    DeviceTrust trust_;
};

}  // namespace relidar
