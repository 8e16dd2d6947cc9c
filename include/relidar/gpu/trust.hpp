// SPDX-License-Identifier: Apache-2.0
// Results of the test that a device must pass when it is first used. Also declares the
// functions that request this test.
#pragma once

#include <functional>
#include <string>

#include <relidar/gpu/device.hpp>

namespace relidar {

/// Result of a check.
enum class CheckVerdict { unknown, right, wrong };

/// Results of the test that a device must pass at its first use. relidar does not use the
/// methods that failed.
struct DeviceTestResults {
    bool float_atomics = true;  ///< True if float atomics add correctly.
    bool float_swaps = true;    ///< True if compare-and-swap loops add correctly.
    /// Subgroup size that kernels request if the driver's default size failed the test. 0
    /// = use the default size.
    int subgroup_size = 0;
    /// Whether ray queries find the same surfels as a search that tests every surfel.
    CheckVerdict ray_query = CheckVerdict::unknown;
};

/// Functions that Device calls when it opens a device.
struct DeviceOpenCallbacks {
    /// Tests float atomics, subgroups and ray queries of a device at its first use, and
    /// again after an update of its driver. The results are stored in the folder of the
    /// pipeline cache. If null, no device is tested and relidar assumes that all of these
    /// work.
    std::function<DeviceTestResults(const DeviceOptions&)> check;
    /// Receives a one-line message for each GPU feature that failed the test by `check`,
    /// for example float atomics. The message says what relidar does instead.
    std::function<void(const std::string&)> note;
};

/// Sets the callbacks for all devices that this process opens later. A program calls this
/// function once, before it opens a device. The standard callback `check` is
/// test_device() in relidar/diff/first_use.hpp.
void set_open_callbacks(DeviceOpenCallbacks callbacks);

/// While this scope object exists, the current thread opens devices with the given test
/// results instead of running the test.
class ScopedDeviceTestResults {
public:
    explicit ScopedDeviceTestResults(const DeviceTestResults& results);
    ~ScopedDeviceTestResults();
    ScopedDeviceTestResults(const ScopedDeviceTestResults&) = delete;
    ScopedDeviceTestResults& operator=(const ScopedDeviceTestResults&) = delete;

private:
    const DeviceTestResults* before_;
    DeviceTestResults trust_;
};

}  // namespace relidar
