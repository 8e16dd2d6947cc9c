// SPDX-License-Identifier: Apache-2.0
#include "gpu/launch_limit.hpp"

#include <algorithm>
#include <array>
#include <string_view>

namespace relidar::gpu {

std::uint32_t LaunchLimit::groups_per_piece(const std::string& kernel) const {
    const std::scoped_lock lock(mutex_);
    const auto known = speeds_.find(kernel);
    if (known == speeds_.end() || !(known->second.s_per_group > 0.0)) return kUnknownGroups;
    return static_cast<std::uint32_t>(std::clamp(piece_s / known->second.s_per_group, 1.0, 4e9));
}

double LaunchLimit::expected_s(const std::string& kernel, std::uint32_t n_groups) const {
    const std::scoped_lock lock(mutex_);
    const auto known = speeds_.find(kernel);
    return known == speeds_.end() ? 0.0 : known->second.s_per_group * n_groups;
}

bool LaunchLimit::should_measure(const std::string& kernel, std::uint32_t n_groups) {
    constexpr std::uint64_t kFirst = 8, kEvery = 64;
    // Skips small launches, because their fixed cost would make the kernel look slow.
    // A kernel whose pieces are small is still measured, because it may become faster.
    if (!is_set() || n_groups < std::min(kUnknownGroups / 4, groups_per_piece(kernel) / 2)) return false;
    const std::scoped_lock lock(mutex_);
    const std::uint64_t n = speeds_[kernel].n_launches++;
    return n < kFirst || n % kEvery == 0;
}

void LaunchLimit::add(const std::string& kernel, std::uint32_t n_groups, double seconds) {
    // Forgets old speeds slowly. The slowest recent launch counts, because the same
    // kernel may be slower in another scene.
    constexpr double kForget = 0.9;
    const std::scoped_lock lock(mutex_);
    double& s_per_group = speeds_[kernel].s_per_group;
    s_per_group = std::max(seconds / n_groups, kForget * s_per_group);
}

bool can_cut(const std::string& kernel) {
    constexpr std::array<std::string_view, 4> kWholeKernels{"diff/accel/bvh_refit", "diff/optimizer/adam",
                                                            "scene/activate_vjp", "gpu/radix_scan"};
    return std::ranges::find(kWholeKernels, kernel) == kWholeKernels.end();
}

}  // namespace relidar::gpu
