// SPDX-License-Identifier: Apache-2.0
#include "check/checks.hpp"

#include <array>

#include <fmt/format.h>

namespace relidar::cli {

/// Returns the table of the checks that need no run, in the order in which they run.
/// Methods of ray tracing have a row for each backend.
std::span<const DeviceCheck> builtin_checks() {
    using enum RayTracingBackend;
    static const std::array checks{
        // static, because the span refers to it
        DeviceCheck{"float atomics", check_atomics},
        DeviceCheck{"compare-and-swap sums", check_compare_swap},
        DeviceCheck{"subgroups", check_subgroups},
        DeviceCheck{"prefix sum", check_prefix_sum},
        DeviceCheck{"sort", check_radix_sort},
        DeviceCheck{"tree of software",
                    [](CheckedDevice& tested) { return check_ray_hits(tested, software); }},
        DeviceCheck{"tree of ray query",
                    [](CheckedDevice& tested) { return check_ray_hits(tested, ray_query); }},
        DeviceCheck{"gradients, software",
                    [](CheckedDevice& tested) { return check_gradients(tested, software); }},
        DeviceCheck{"gradients, ray query",
                    [](CheckedDevice& tested) { return check_gradients(tested, ray_query); }},
        DeviceCheck{"Adam", check_adam},
        DeviceCheck{"ray-drop network", check_network},
        DeviceCheck{"points on the device", check_points},
        DeviceCheck{"largest buffer", check_buffer},
        DeviceCheck{"memory", check_memory},
        DeviceCheck{"longest dispatch", check_dispatch},
    };
    return checks;
}

CheckResult compare_error(double error, double tolerance) {
    // NaN counts as wrong
    const bool is_right = error <= tolerance;
    return {is_right ? CheckOutcome::right : CheckOutcome::wrong,
            is_right && error == 0.0
                ? "exact"
                : fmt::format("found an error of {:.1e}, expected at most {:.0e}", error, tolerance)};
}

CheckResult passed_check(const std::string& text) { return {CheckOutcome::right, text}; }
CheckResult failed_check(const std::string& reason) { return {CheckOutcome::wrong, reason}; }
CheckResult unsupported_check(const std::string& reason) { return {CheckOutcome::unsupported, reason}; }

CheckedDevice::CheckedDevice(const DeviceOptions& options)
    : options_(options), default_(std::make_unique<Device>(options)) {
    options_.index = default_->info().index;
}

Device& CheckedDevice::device_with(RayTracingBackend backend) {
    if (default_->backend() == backend) return *default_;
    std::unique_ptr<Device>& device = others_[backend];
    if (!device) {
        DeviceOptions options = options_;
        options.traversal = backend;
        device = std::make_unique<Device>(options);
    }
    return *device;
}

}  // namespace relidar::cli
