// SPDX-License-Identifier: Apache-2.0
// Device settings that only tests change, and the number of validation messages.
#pragma once

#include <cstddef>
#include <optional>

#include <relidar/gpu/device.hpp>

namespace relidar {

/// Returns the number of validation warnings and errors of a device so far. Returns 0 if
/// validation is disabled.
std::size_t validation_messages(const Device& device);

/// Settings that replace the choices made for the device.
struct ForcedWays {
    bool brute_force = false;  ///< rays test every surfel instead of using the acceleration structure
    /// If set, decides whether neighbouring threads read neighbouring floats, as on a
    /// GPU.
    std::optional<bool> coalesces = std::nullopt;
    /// if set, the number of scans rendered simultaneously, see
    /// ScanRenderer::side_by_side()
    std::optional<int> side_by_side = std::nullopt;
};

/// Applies the settings to everything that is created on a device during the lifetime of
/// this object.
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
