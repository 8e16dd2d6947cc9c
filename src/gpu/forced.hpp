// SPDX-License-Identifier: Apache-2.0
// Settings of a device that only tests change, and the validation messages that tests
// count.
#pragma once

#include <cstddef>
#include <optional>

#include <relidar/gpu/device.hpp>

namespace relidar {

/// Validation messages of severity warning or error that a device has seen so far (0
/// without validation).
std::size_t validation_messages(const Device& device);

/// What is done in another way than suits the device.
struct ForcedWays {
    bool brute_force = false;  ///< rays test every surfel in the place of a search
    /// threads beside each other read floats beside each other, as GPUs want it
    std::optional<bool> coalesces = std::nullopt;
    std::optional<int> side_by_side = std::nullopt;  ///< see ScanRenderer::side_by_side()
};

/// While it lives, what is made on a device is made so.
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
