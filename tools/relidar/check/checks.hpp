// SPDX-License-Identifier: Apache-2.0
// Checks of `relidar check`. A check runs kernels on small inputs whose results the host
// knows exactly or computes in double precision. To add a check, write a file with a
// function, declare the function here, and add its row in checks.cpp.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <span>
#include <string>

#include <relidar/gpu/device.hpp>

namespace relidar::cli {

/// Result of a check.
struct Finding {
    enum class Kind { right, wrong, unsupported };
    Kind kind = Kind::right;
    std::string text;  ///< Error, or the reason of another result.
};
/// Returns `right` with the error if it is at most the tolerance, otherwise `wrong`.
Finding judge(double error, double tolerance);
Finding wrong(const std::string& text);
Finding unsupported(const std::string& why);

/// A device, opened once for each traversal that a check needs.
class CheckedDevice {
public:
    /// Opens the device with its default traversal.
    explicit CheckedDevice(const DeviceOptions& options);
    Device& device() { return *default_; }
    /// Returns the device with a traversal. Opens it at the first call.
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
std::span<const Check> all_checks();

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

}  // namespace relidar::cli
