// SPDX-License-Identifier: Apache-2.0
// Device settings that only tests change, and the number of validation messages.
#pragma once

#include <cstddef>
#include <optional>

#include <relidar/gpu/device.hpp>

namespace relidar {

/// Returns the number of validation messages of severity warning or error so far (0
/// without validation).
std::size_t validation_messages(const Device& device);

/// Device behaviour that a test forces instead of the default.
struct ForcedWays {
    bool brute_force = false;  ///< If true, rays test every surfel instead of searching a tree.
    /// If true, neighbouring threads read neighbouring floats, as on GPUs.
    std::optional<bool> coalesces = std::nullopt;
    /// Number of scans that a renderer processes concurrently; see
    /// ScanRenderer::side_by_side().
    std::optional<int> side_by_side = std::nullopt;
};

/// Scope in which objects created on a device use the forced behaviour.
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
