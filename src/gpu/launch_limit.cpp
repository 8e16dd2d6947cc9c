// SPDX-License-Identifier: Apache-2.0
#include "gpu/launch_limit.hpp"

#include <algorithm>
#include <array>
#include <string_view>

namespace relidar::gpu {

std::uint32_t KernelSpeed::workgroups_for(double target_dispatch_s) const {
    const double s_per_group = s_per_group_;
    if (!(s_per_group > 0.0)) return kUnknownGroups;
    return static_cast<std::uint32_t>(std::clamp(target_dispatch_s / s_per_group, 1.0, 4e9));
}

double KernelSpeed::estimate_s(std::uint32_t n_workgroups) const { return s_per_group_ * n_workgroups; }

/// Returns true if a dispatch should be measured: the first few, and then every 64th.
bool KernelSpeed::should_measure(double target_dispatch_s, std::uint32_t n_workgroups) {
    constexpr std::uint64_t kFirstMeasured = 8, kMeasureInterval = 64;
    // Does not measure small dispatches, because their fixed cost would make the kernel
    // look slow. Exception: the launches of a slow kernel are split into small
    // dispatches. They are measured, so that a kernel that has become faster is noticed.
    if (n_workgroups < std::min(kUnknownGroups / 4, workgroups_for(target_dispatch_s) / 2)) return false;
    const std::uint64_t n = n_dispatches_++;
    return n < kFirstMeasured || n % kMeasureInterval == 0;
}

/// Updates the time per workgroup with a measured dispatch. The estimate jumps up to a
/// slower measurement but falls slowly, because a kernel may be slower in another scene.
void KernelSpeed::add_dispatch(std::uint32_t n_workgroups, double duration_s) {
    // Part of the old estimate that is kept if the new measurement is faster.
    constexpr double kOldWeight = 0.9;
    s_per_group_ = std::max(duration_s / n_workgroups, kOldWeight * s_per_group_);
}

KernelSpeed& LaunchTimeLimit::speed_of(const std::string& kernel_name) {
    const std::scoped_lock lock(mutex_);
    return speeds_[kernel_name];
}

/// Returns true if launches of this kernel may be split into several dispatches. Kernels
/// that read the total number of workgroups must not be split, because each dispatch
/// would report a smaller number.
bool can_split(const std::string& kernel_name) {
    constexpr std::array<std::string_view, 4> kUnsplittableKernels{
        "diff/accel/bvh_refit", "diff/optimizer/adam", "scene/activate_vjp", "gpu/radix_scan"};
    return std::ranges::find(kUnsplittableKernels, kernel_name) == kUnsplittableKernels.end();
}

}  // namespace relidar::gpu
