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

struct CheckResult {
    enum class CheckOutcome { right, wrong, unsupported };
    CheckOutcome kind = CheckOutcome::right;
    std::string text;  ///< Size of the error, or the reason why the check is wrong or unsupported.
};
CheckResult make_check_result_from_error(double error, double tolerance);
CheckResult make_failed_check_result(const std::string& reason);
CheckResult make_unsupported_check_result(const std::string& reason);
/// Empty if the device can use the method.
std::string explain_unsupported_backend(const DeviceInfo& device_info, RayTracingBackend backend);

/// Opened separately for each ray tracing method that the checks need.
class CheckedDevice {
public:
    explicit CheckedDevice(const DeviceOptions& options);
    Device& get_default_device() { return *default_; }
    Device& get_or_open_device_with_backend(RayTracingBackend backend);
    const DeviceOptions& get_device_options() const { return options_; }

private:
    DeviceOptions options_;
    std::unique_ptr<Device> default_;
    std::map<RayTracingBackend, std::unique_ptr<Device>> others_;
};

struct DeviceCheck {
    const char* name;
    std::function<CheckResult(CheckedDevice&)> run;
};
std::span<const DeviceCheck> get_builtin_device_checks();

CheckResult check_float_atomics(CheckedDevice& tested_device);
CheckResult check_float_compare_and_swap(CheckedDevice& tested_device);
CheckResult check_subgroup_operations(CheckedDevice& tested_device);
CheckResult check_prefix_sum(CheckedDevice& tested_device);
CheckResult check_radix_sort(CheckedDevice& tested_device);
CheckResult check_bvh_ray_hits(CheckedDevice& tested_device, RayTracingBackend backend);
CheckResult check_images_and_gradients(CheckedDevice& tested_device, RayTracingBackend backend);
CheckResult check_adam_optimizer(CheckedDevice& tested_device);
CheckResult check_network_convolutions(CheckedDevice& tested_device);
CheckResult check_points_computed_on_device(CheckedDevice& tested_device);
CheckResult check_largest_buffer(CheckedDevice& tested_device);
CheckResult check_device_memory(CheckedDevice& tested_device);
CheckResult check_long_kernel_dispatch(CheckedDevice& tested_device);
/// The reference renderer uses double precision.
CheckResult check_rendering_of_trained_run(CheckedDevice& tested_device, RayTracingBackend backend,
                                           const BenchCase& bench_case);

}  // namespace relidar::cli
