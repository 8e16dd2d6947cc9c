// SPDX-License-Identifier: Apache-2.0
// Defines the delay between an iteration and the evaluation of its report. Private to
// train.
#pragma once

#include "gpu/stream.hpp"

namespace relidar {

/// The report of iteration i is evaluated before the commands of iteration i +
/// kReadbackLag are recorded. At that time, the stream waits for iteration i anyway,
/// because it reuses the command buffer. Therefore the evaluation needs no additional
/// wait. The lag is fixed, so training is repeatable.
inline constexpr int kReadbackLag = static_cast<int>(Stream::Impl::kSlots);

}  // namespace relidar
