// SPDX-License-Identifier: Apache-2.0
// Defines how many iterations pass before the host reads the report of an iteration.
// Private to train.
#pragma once

#include "gpu/stream.hpp"

namespace relidar {

/// Number of iterations after which the host reads the report of an iteration. At this
/// time, the stream waits for that iteration anyway, because it reuses the command
/// buffer. Reading the report then needs no additional wait. The number is constant, so
/// that training is repeatable.
inline constexpr int kReadbackLag = static_cast<int>(Stream::Impl::kSlots);

}  // namespace relidar
