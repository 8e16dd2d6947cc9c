// SPDX-License-Identifier: Apache-2.0
// Declares the checks of the command `relidar check`. Each check runs GPU kernels on
// small inputs and compares the results with exact or double-precision results of the
// CPU. To add a check, write its function in a new file, declare the function here, and
// add a row in checks.cpp.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <span>
#include <string>

#include <relidar/gpu/device.hpp>

namespace relidar::cli {

struct BenchCase;

/// Result of a check.
struct Finding {
    enum class Kind { right, wrong, unsupported };
    Kind kind = Kind::right;
    std::string text;  ///< Size of the error, or the reason why the check is wrong or unsupported.
};
/// Returns the result "right" if the error is at most the tolerance, otherwise "wrong".
Finding judge(double error, double tolerance);
Finding make_wrong_finding(const std::string& text);
Finding make_unsupported_finding(const std::string& why);
/// Returns the reason why a device cannot use a method to trace rays. The text is empty
/// if the device can use it.
std::string explain_unsupported(const DeviceInfo& info, Traversal traversal);

/// A device under test. It is opened separately for each ray tracing method (software or
/// ray query) that the checks need.
class CheckedDevice {
public:
    /// Opens the device with its default traversal.
    explicit CheckedDevice(const DeviceOptions& options);
    Device& device() { return *default_; }
    /// Returns the device with the given method to trace rays. Opens the device at the
    /// first call.
    Device& with(Traversal traversal);
    const DeviceOptions& options() const { return options_; }

private:
    DeviceOptions options_;
    std::unique_ptr<Device> default_;
    std::map<Traversal, std::unique_ptr<Device>> others_;
};

struct Check {
    const char* name;
    std::function<Finding(CheckedDevice&)> run;
};
std::span<const Check> list_all_checks();

Finding check_float_atomics(CheckedDevice& checked);
Finding check_float_swaps(CheckedDevice& checked);
Finding check_subgroups(CheckedDevice& checked);
Finding check_prefix_sum(CheckedDevice& checked);
Finding check_sort(CheckedDevice& checked);
Finding check_tree(CheckedDevice& checked, Traversal traversal);
Finding check_render(CheckedDevice& checked, Traversal traversal);
Finding check_adam(CheckedDevice& checked);
Finding check_network(CheckedDevice& checked);
Finding check_points(CheckedDevice& checked);
Finding check_large_buffer(CheckedDevice& checked);
Finding check_memory(CheckedDevice& checked);
Finding check_long_dispatch(CheckedDevice& checked);
/// Compares rendered rays of a run with the double reference.
Finding check_run(CheckedDevice& checked, Traversal traversal, const BenchCase& bench);

}  // namespace relidar::cli
