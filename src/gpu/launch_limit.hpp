// SPDX-License-Identifier: Apache-2.0
// Limits the duration of a dispatch, because drivers and operating systems reset a GPU if
// a dispatch takes seconds. Splits a large launch into several dispatches. Earlier
// launches of the same kernel give the expected duration.
#pragma once

#include <cstdint>
#include <map>
#include <mutex>
#include <string>

namespace relidar::gpu {

/// Measured speeds of the kernels of a device. Thread-safe.
class LaunchLimit {
public:
    /// Number of workgroups per dispatch for a kernel whose speed is unknown.
    static constexpr std::uint32_t kUnknownGroups = 4096;

    /// Target duration of a dispatch and of a submission, in seconds. The target is half
    /// of the allowed duration, because speeds vary. 0 means no limit.
    double piece_s = 0.0;

    bool is_set() const { return piece_s > 0.0; }
    /// Returns the number of workgroups that one dispatch of this kernel should have.
    std::uint32_t groups_per_piece(const std::string& kernel) const;
    /// Returns the expected duration of `n_groups` workgroups in seconds. Returns 0 if
    /// the speed of the kernel is unknown.
    double expected_s(const std::string& kernel, std::uint32_t n_groups) const;
    /// Returns true if the next launch should be measured. The first 8 launches of a
    /// kernel are measured, and then every 64th.
    bool should_measure(const std::string& kernel, std::uint32_t n_groups);
    void add(const std::string& kernel, std::uint32_t n_groups, double seconds);

private:
    struct Speed {
        double s_per_group = 0.0;
        std::uint64_t n_launches = 0;
    };
    mutable std::mutex mutex_;
    std::map<std::string, Speed> speeds_;
};

/// Returns true if launches of this kernel may be split into several dispatches. Kernels
/// that read the total number of workgroups must not be split, because each dispatch
/// would report a smaller number.
bool can_cut(const std::string& kernel);

}  // namespace relidar::gpu
