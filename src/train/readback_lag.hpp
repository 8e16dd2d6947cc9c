// SPDX-License-Identifier: Apache-2.0
// Defines how many iterations pass before the host reads the report of an iteration.
// Private to train.
#pragma once

#include "gpu/stream.hpp"

namespace relidar {

/// The host reads the report of iteration i just before it records iteration i +
/// kReadbackLag. At this time, the stream waits for iteration i in any case, because it
/// reuses the command buffer. Therefore reading the report needs no additional wait.
/// Training is repeatable, because the lag is constant.
inline constexpr int kReadbackLag = static_cast<int>(Stream::Impl::kSlots);

}  // namespace relidar
