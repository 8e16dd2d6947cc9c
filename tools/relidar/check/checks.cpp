// SPDX-License-Identifier: Apache-2.0
#include "check/checks.hpp"

#include <array>

#include <fmt/format.h>

namespace relidar::cli {

std::span<const DeviceCheck> builtin_checks() {
    using enum RayTracingBackend;
    static const std::array checks{
        DeviceCheck{"float atomics", check_atomics},
        DeviceCheck{"compare-and-swap sums", check_compare_swap},
        DeviceCheck{"subgroups", check_subgroups},
        DeviceCheck{"prefix sum", check_prefix_sum},
        DeviceCheck{"sort", check_radix_sort},
        DeviceCheck{"tree of software", [](CheckedDevice& c) { return check_ray_hits(c, software); }},
        DeviceCheck{"tree of ray query", [](CheckedDevice& c) { return check_ray_hits(c, ray_query); }},
        DeviceCheck{"gradients, software", [](CheckedDevice& c) { return check_gradients(c, software); }},
        DeviceCheck{"gradients, ray query", [](CheckedDevice& c) { return check_gradients(c, ray_query); }},
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
    return {is_right ? CheckResult::CheckOutcome::right : CheckResult::CheckOutcome::wrong,
            is_right && error == 0.0
                ? "exact"
                : fmt::format("found an error of {:.1e}, expected at most {:.0e}", error, tolerance)};
}

CheckResult failed_check(const std::string& reason) { return {CheckResult::CheckOutcome::wrong, reason}; }
CheckResult unsupported_check(const std::string& reason) {
    return {CheckResult::CheckOutcome::unsupported, reason};
}

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
