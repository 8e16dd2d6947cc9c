// SPDX-License-Identifier: Apache-2.0
// Limits the duration of a dispatch, because drivers and operating systems reset a GPU if
// a dispatch takes seconds. Splits a large launch into several dispatches. The expected
// duration is computed from earlier launches of the same kernel.
#pragma once

#include <atomic>
#include <cstdint>
#include <map>
#include <mutex>
#include <string>

namespace relidar::gpu {

/// Has no lock, because every launch reads it. If two threads add measurements
/// simultaneously, one measurement can be lost.
class KernelSpeed {
public:
    static constexpr std::uint32_t kUnknownGroups = 4096;

    std::uint32_t workgroups_for(double target_dispatch_s) const;
    double estimate_s(std::uint32_t n_workgroups) const;
    /// The first 8 dispatches of a kernel are measured, and then every 64th.
    bool should_measure(double target_dispatch_s, std::uint32_t n_workgroups);
    void add_dispatch(std::uint32_t n_workgroups, double duration_s);

private:
    std::atomic<double> s_per_group_{0.0};
    std::atomic<std::uint64_t> n_dispatches_{0};
};

class LaunchTimeLimit {
public:
    /// Half of the duration that drivers allow, because speeds vary. 0 = no limit.
    double piece_s = 0.0;

    bool has_limit() const { return piece_s > 0.0; }
    /// The reference stays valid. Thread-safe.
    KernelSpeed& speed_of(const std::string& kernel_name);

private:
    std::mutex mutex_;
    std::map<std::string, KernelSpeed> speeds_;
};

/// False for kernels that read the total number of workgroups.
bool can_split(const std::string& kernel_name);

}  // namespace relidar::gpu
