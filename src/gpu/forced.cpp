// SPDX-License-Identifier: Apache-2.0
#include "gpu/forced.hpp"

#include <utility>

#include "gpu/context.hpp"
#include "gpu/kernel.hpp"

namespace relidar {

std::size_t validation_messages(const Device& device) { return device.impl().instance->n_messages; }

Forced::Forced(Device& device, const ForcedWays& ways)
    : device_(device), before_(std::exchange(device.impl().forced, ways)) {}
Forced::~Forced() { device_.impl().forced = before_; }

bool coalesces(const Device& device) {
    return device.impl().forced.coalesces.value_or(device.info().type != "CPU");
}
bool tests_every_surfel(const Device& device) { return device.impl().forced.brute_force; }

}  // namespace relidar
