// SPDX-License-Identifier: Apache-2.0
// Checks that many threads can add to the same float without an error. Also checks the
// subgroup operations.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/gpu/trust.hpp>
#include "check/checks.hpp"
#include "gpu/check_device.hpp"

namespace relidar::cli {
namespace {

/// Float represents the sums of small integers exactly.
CheckResult make_result_of_exact_sum_check(double relative_error) {
    if (relative_error == 0.0) return {CheckResult::CheckOutcome::right, "exact"};
    return make_failed_check_result(
        fmt::format("found a sum with a relative error of {:.3g}, expected an exact sum", relative_error));
}

}  // namespace

CheckResult check_float_atomics(CheckedDevice& tested_device) {
    if (!tested_device.get_default_device().info().float_atomics)
        return make_unsupported_check_result(
            "the driver has no VK_EXT_shader_atomic_float, or its sums are known to be wrong");
    return make_result_of_exact_sum_check(
        test_atomic_adds_and_get_max_error(tested_device.get_default_device(), false));
}

CheckResult check_float_compare_and_swap(CheckedDevice& tested_device) {
    return make_result_of_exact_sum_check(
        test_atomic_adds_and_get_max_error(tested_device.get_default_device(), true));
}

CheckResult check_subgroup_operations(CheckedDevice& tested_device) {
    const DeviceInfo& info = tested_device.get_default_device().info();
    if (!info.can_require_subgroup_size)
        return make_unsupported_check_result("the device does not report its subgroup size");
    const std::vector<int> sizes = list_requestable_subgroup_sizes(tested_device.get_default_device());
    for (const int lanes : sizes) {
        const ScopedDeviceTestResults trusting(DeviceTestResults{.subgroup_size = lanes});
        Device device(tested_device.get_device_options());
        const std::string text = test_subgroups_and_describe_error(device);
        if (!text.empty())
            return make_failed_check_result(fmt::format("subgroups of {} lanes: {}", lanes, text));
    }
    return {CheckResult::CheckOutcome::right, fmt::format("subgroups of {} lanes", fmt::join(sizes, ", "))};
}

}  // namespace relidar::cli
