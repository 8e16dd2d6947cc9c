// SPDX-License-Identifier: Apache-2.0
#include "gpu/forced.hpp"

#include "gpu/context.hpp"
#include "gpu/kernel.hpp"

namespace relidar {

std::size_t validation_count(const Device& device) {
    return device.impl().instance ? device.impl().instance->n_messages.load() : 0;
}

ForcedBehaviourScope::ForcedBehaviourScope(Device& device, const ForcedBehaviour& forced)
    : device_(device), before_(std::exchange(device.impl().forced, forced)) {}
ForcedBehaviourScope::~ForcedBehaviourScope() { device_.impl().forced = before_; }

bool should_coalesce(const Device& device) {
    return device.impl().forced.coalesces.value_or(device.info().type != "CPU");
}
bool is_brute_force(const Device& device) { return device.impl().forced.brute_force; }

}  // namespace relidar
