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

enum class CheckOutcome { right, wrong, unsupported };

struct CheckResult {
    CheckOutcome kind = CheckOutcome::right;
    std::string text;  ///< Size of the error, or the reason why the check is wrong or unsupported.
};
CheckResult compare_error(double error, double tolerance);
CheckResult passed_check(const std::string& text = "exact");
CheckResult failed_check(const std::string& reason);
CheckResult unsupported_check(const std::string& reason);
/// Empty if the device can use the method.
std::string why_unsupported(const DeviceInfo& device_info, RayTracingBackend backend);

/// Opened separately for each ray tracing method that the checks need.
class CheckedDevice {
public:
    explicit CheckedDevice(const DeviceOptions& options);
    Device& default_device() { return *default_; }
    /// Opens the device with this backend when it is needed for the first time.
    Device& device_with(RayTracingBackend backend);
    const DeviceOptions& device_options() const { return options_; }

private:
    DeviceOptions options_;
    std::unique_ptr<Device> default_;
    std::map<RayTracingBackend, std::unique_ptr<Device>> others_;
};

struct DeviceCheck {
    const char* name;
    std::function<CheckResult(CheckedDevice&)> run;
};
std::span<const DeviceCheck> builtin_checks();

CheckResult check_atomics(CheckedDevice& tested);
CheckResult check_compare_swap(CheckedDevice& tested);
CheckResult check_subgroups(CheckedDevice& tested);
CheckResult check_prefix_sum(CheckedDevice& tested);
CheckResult check_radix_sort(CheckedDevice& tested);
CheckResult check_ray_hits(CheckedDevice& tested, RayTracingBackend backend);
CheckResult check_gradients(CheckedDevice& tested, RayTracingBackend backend);
CheckResult check_adam(CheckedDevice& tested);
CheckResult check_network(CheckedDevice& tested);
CheckResult check_points(CheckedDevice& tested);
CheckResult check_buffer(CheckedDevice& tested);
CheckResult check_memory(CheckedDevice& tested);
CheckResult check_dispatch(CheckedDevice& tested);
/// Compares rendered rays of a trained scene with the reference renderer, which uses
/// double precision.
CheckResult check_run_scene(CheckedDevice& tested, RayTracingBackend backend, const BenchCase& tested_case);

}  // namespace relidar::cli
