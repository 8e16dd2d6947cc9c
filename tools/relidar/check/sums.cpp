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
CheckResult exact_result(double relative_error) {
    if (relative_error == 0.0) return passed_check();
    return failed_check(
        fmt::format("found a sum with a relative error of {:.3g}, expected an exact sum", relative_error));
}

}  // namespace

CheckResult check_atomics(CheckedDevice& tested) {
    if (!tested.default_device().info().float_atomics)
        return unsupported_check(
            "the driver has no VK_EXT_shader_atomic_float, or its sums are known to be wrong");
    return exact_result(test_atomic_adds(tested.default_device(), AtomicAddMethod::float_atomics));
}

CheckResult check_compare_swap(CheckedDevice& tested) {
    return exact_result(test_atomic_adds(tested.default_device(), AtomicAddMethod::compare_and_swap));
}

/// Tests the operations within a subgroup, a group of threads (lanes) that run together,
/// for each subgroup size of the device.
CheckResult check_subgroups(CheckedDevice& tested) {
    const DeviceInfo& info = tested.default_device().info();
    if (!info.can_require_subgroup_size)
        return unsupported_check("the device does not report its subgroup size");
    const std::vector<int> sizes = subgroup_sizes(tested.default_device());
    for (const int lanes : sizes) {
        // Opens the device as if the test at first use had chosen this subgroup size.
        const ScopedDeviceTestResults chosen(DeviceTestResults{.subgroup_size = lanes});
        Device device(tested.device_options());
        const std::string text = test_subgroups(device);
        if (!text.empty()) return failed_check(fmt::format("subgroups of {} lanes: {}", lanes, text));
    }
    return passed_check(fmt::format("subgroups of {} lanes", fmt::join(sizes, ", ")));
}

/// Checks that the driver does not abort a dispatch of a quarter of a second, as some do.
/// relidar splits longer work.
CheckResult check_dispatch(CheckedDevice& tested) {
    constexpr double kDispatchTime_s = 0.25;
    // Runs the kernel once, so that its compile time is not measured.
    test_atomic_adds(tested.default_device(), AtomicAddMethod::compare_and_swap);
    // Each dispatch has four times as many threads as the previous one. The loop ends at
    // a dispatch of 0.25 s, so the last one takes about one second at most.
    for (std::uint32_t n_threads = 1u << 18; n_threads <= 1u << 28; n_threads *= 4) {
        double seconds = 0.0;
        const double error = test_swap_adds(tested.default_device(), n_threads, seconds);
        if (error != 0.0)
            return failed_check(
                fmt::format("after a computation of {:.2f} s, found sums with a relative error of {:.1e}, "
                            "expected exact sums",
                            seconds, error));
        if (seconds >= kDispatchTime_s)
            return passed_check(fmt::format("exact sums after a computation of {:.2f} s", seconds));
    }
    return passed_check(
        "exact sums; the longest computation, with 268 million threads, took less than 0.25 s");
}

}  // namespace relidar::cli
