// SPDX-License-Identifier: Apache-2.0
#include "gpu/forced.hpp"

#include <utility>

#include "gpu/context.hpp"
#include "gpu/kernel.hpp"

namespace relidar {

std::size_t validation_messages(const Device& device) { return impl_of(device).instance->n_messages; }

Forced::Forced(Device& device, const ForcedWays& ways)
    : device_(device), before_(std::exchange(impl_of(device).forced, ways)) {}
Forced::~Forced() { impl_of(device_).forced = before_; }

bool coalesces(const Device& device) {
    return impl_of(device).forced.coalesces.value_or(device.info().type != "CPU");
}
bool tests_every_surfel(const Device& device) { return impl_of(device).forced.brute_force; }

}  // namespace relidar
