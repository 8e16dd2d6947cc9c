// SPDX-License-Identifier: Apache-2.0
#include "gpu/forced.hpp"

#include <utility>

#include "gpu/context.hpp"
#include "gpu/kernel.hpp"

namespace relidar {

std::size_t count_validation_messages(const Device& device) { return device.impl().instance->n_messages; }

ForcedBehaviourScope::ForcedBehaviourScope(Device& device, const ForcedBehaviour& ways)
    : device_(device), before_(std::exchange(device.impl().forced, ways)) {}
ForcedBehaviourScope::~ForcedBehaviourScope() { device_.impl().forced = before_; }

bool prefers_coalesced_access(const Device& device) {
    return device.impl().forced.coalesces.value_or(device.info().type != "CPU");
}
bool must_test_every_surfel(const Device& device) { return device.impl().forced.brute_force; }

}  // namespace relidar
