// SPDX-License-Identifier: Apache-2.0
// Limits the duration of a dispatch. Drivers and operating systems reset a GPU if a
// dispatch takes seconds. Large launches are cut into pieces by the speed of earlier
// launches of the same kernel.
#pragma once

#include <cstdint>
#include <map>
#include <mutex>
#include <string>

namespace relidar::gpu {

/// Speeds of kernels on a device. Thread-safe.
class LaunchLimit {
public:
    /// Number of workgroups in a piece of a kernel of unknown speed.
    static constexpr std::uint32_t kUnknownGroups = 4096;

    /// Expected duration of a piece and of a submission, in seconds. It is half of the
    /// longest duration that is allowed, because speeds vary. 0 = no limit.
    double piece_s = 0.0;

    bool is_set() const { return piece_s > 0.0; }
    /// Returns the number of workgroups in a piece of a launch.
    std::uint32_t groups_per_piece(const std::string& kernel) const;
    /// Returns the expected duration of workgroups of a kernel. 0 if its speed is
    /// unknown.
    double expected_s(const std::string& kernel, std::uint32_t n_groups) const;
    /// Returns true if the next launch should be measured: each of the first 8, then
    /// every 64th.
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

/// Returns true if a kernel may be cut into pieces. Other kernels read the number of all
/// workgroups, which differs between a launch and its pieces.
bool can_cut(const std::string& kernel);

}  // namespace relidar::gpu
