// SPDX-License-Identifier: Apache-2.0
// Defines how many iterations pass before the host reads the report of an iteration.
// Private to train.
#pragma once

#include "gpu/stream.hpp"

namespace relidar {

/// The host reads the report (losses and counters) of iteration i in iteration i +
/// kReadbackLag. At this time, the stream waits for iteration i anyway, because it reuses
/// the command buffer of this iteration. Reading the report then needs no additional
/// wait. The number is constant, so that training is repeatable.
inline constexpr int kReadbackLag = static_cast<int>(Stream::Impl::kSlots);

}  // namespace relidar
