// SPDX-License-Identifier: Apache-2.0
// Device settings that only tests change, and the number of validation messages.
#pragma once

#include <cstddef>
#include <optional>

#include <relidar/gpu/device.hpp>

namespace relidar {

std::size_t validation_count(const Device& device);

struct ForcedBehaviour {
    bool brute_force = false;
    /// Whether neighbouring threads access neighbouring floats. Default: not on a CPU.
    std::optional<bool> coalesces = std::nullopt;
    std::optional<int> side_by_side = std::nullopt;
};

class ForcedBehaviourScope {
public:
    ForcedBehaviourScope(Device& device, const ForcedBehaviour& forced);
    ~ForcedBehaviourScope();
    ForcedBehaviourScope(const ForcedBehaviourScope&) = delete;
    ForcedBehaviourScope& operator=(const ForcedBehaviourScope&) = delete;

private:
    Device& device_;
    ForcedBehaviour before_;
};

}  // namespace relidar
