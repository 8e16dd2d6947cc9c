// SPDX-License-Identifier: Apache-2.0
// Delay between an iteration and the evaluation of its report. Private to train.
#pragma once

#include "gpu/stream.hpp"

namespace relidar {

/// The report of iteration i is evaluated before iteration i + kReadbackLag is recorded.
/// At that time, the stream waits for that submission anyway, because it reuses its slot.
/// So the evaluation needs no additional wait, and the fixed lag makes training
/// repeatable.
inline constexpr int kReadbackLag = static_cast<int>(Stream::Impl::kSlots);

}  // namespace relidar
