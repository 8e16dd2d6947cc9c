// SPDX-License-Identifier: Apache-2.0
#include "check/checks.hpp"

#include <array>

#include <fmt/format.h>

namespace relidar::cli {

std::span<const Check> list_all_checks() {
    using enum Traversal;
    static const std::array checks{
        Check{"float atomics", check_float_atomics},
        Check{"compare-and-swap sums", check_float_swaps},
        Check{"subgroups", check_subgroups},
        Check{"prefix sum", check_prefix_sum},
        Check{"sort", check_sort},
        Check{"tree of software", [](CheckedDevice& c) { return check_tree(c, software); }},
        Check{"tree of ray query", [](CheckedDevice& c) { return check_tree(c, ray_query); }},
        Check{"gradients, software", [](CheckedDevice& c) { return check_render(c, software); }},
        Check{"gradients, ray query", [](CheckedDevice& c) { return check_render(c, ray_query); }},
        Check{"Adam", check_adam},
        Check{"ray-drop network", check_network},
        Check{"points on the device", check_points},
        Check{"largest buffer", check_large_buffer},
        Check{"memory", check_memory},
        Check{"longest dispatch", check_long_dispatch},
    };
    return checks;
}

Finding judge(double error, double tolerance) {
    // If the error is NaN, this comparison is false, so NaN counts as wrong.
    const bool is_right = error <= tolerance;
    return {is_right ? Finding::Kind::right : Finding::Kind::wrong,
            is_right && error == 0.0
                ? "exact"
                : fmt::format("found an error of {:.1e}, expected at most {:.0e}", error, tolerance)};
}

Finding make_wrong_finding(const std::string& text) { return {Finding::Kind::wrong, text}; }
Finding make_unsupported_finding(const std::string& why) { return {Finding::Kind::unsupported, why}; }

CheckedDevice::CheckedDevice(const DeviceOptions& options)
    : options_(options), default_(std::make_unique<Device>(options)) {
    options_.index = default_->info().index;
}

Device& CheckedDevice::with(Traversal traversal) {
    if (default_->traversal() == traversal) return *default_;
    std::unique_ptr<Device>& device = others_[traversal];
    if (!device) {
        DeviceOptions options = options_;
        options.traversal = traversal;
        device = std::make_unique<Device>(options);
    }
    return *device;
}

}  // namespace relidar::cli
