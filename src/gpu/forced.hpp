// SPDX-License-Identifier: Apache-2.0
// Device settings that only tests change. Also returns the number of validation messages.
#pragma once

#include <cstddef>
#include <optional>

#include <relidar/gpu/device.hpp>

namespace relidar {

/// Returns the number of warnings and errors that the Vulkan validation layer has
/// reported. Returns 0 without validation.
std::size_t validation_messages(const Device& device);

/// Device behaviour that a test selects instead of the default.
struct ForcedWays {
    /// If true, rays test every surfel instead of searching an acceleration structure.
    bool brute_force = false;
    /// If true, neighbouring threads read neighbouring floats, which is the default on
    /// GPUs.
    std::optional<bool> coalesces = std::nullopt;
    /// Number of scans that a renderer processes concurrently. See
    /// ScanRenderer::side_by_side().
    std::optional<int> side_by_side = std::nullopt;
};

/// Scope object: while it exists, new objects on a device use the behaviour that a test
/// selects.
class Forced {
public:
    Forced(Device& device, const ForcedWays& ways);
    ~Forced();
    Forced(const Forced&) = delete;
    Forced& operator=(const Forced&) = delete;

private:
    Device& device_;
    ForcedWays before_;
};

}  // namespace relidar
