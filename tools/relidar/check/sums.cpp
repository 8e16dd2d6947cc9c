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

/// Returns the result "right" only if a sum is exact. The sums are of small integers,
/// which are exact in float.
Finding judge_sum_error(double error) {
    if (error == 0.0) return {Finding::Kind::right, "exact"};
    return make_wrong_finding(fmt::format("a sum has a relative error of {:.3g}", error));
}

}  // namespace

Finding check_float_atomics(CheckedDevice& checked) {
    if (!checked.device().info().float_atomics)
        return make_unsupported_finding("no VK_EXT_shader_atomic_float");
    return judge_sum_error(compute_sum_error(checked.device(), false));
}

Finding check_float_swaps(CheckedDevice& checked) {
    return judge_sum_error(compute_sum_error(checked.device(), true));
}

Finding check_subgroups(CheckedDevice& checked) {
    const DeviceInfo& info = checked.device().info();
    if (!info.has_known_subgroups)
        return make_unsupported_finding("the device does not report its subgroup size");
    const std::vector<int> sizes = list_subgroup_sizes(checked.device());
    for (const int lanes : sizes) {
        const Trusting trusting(DeviceTrust{.subgroup_size = lanes});
        Device device(checked.options());
        const std::string text = find_wrong_subgroups(device);
        if (!text.empty()) return make_wrong_finding(fmt::format("{} lanes, {}", lanes, text));
    }
    return {Finding::Kind::right, fmt::format("{} lanes", fmt::join(sizes, ", "))};
}

}  // namespace relidar::cli
