// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "gpu/stream.hpp"

namespace relidar {

/// The host reads the report (losses and counters) of iteration i in iteration i +
/// kReadbackLag. The stream then waits for iteration i anyway, because it reuses its
/// command buffer. Constant, so that training is repeatable.
inline constexpr int kReadbackLag = static_cast<int>(Stream::Impl::kMaxPending);

}  // namespace relidar
