// SPDX-License-Identifier: Apache-2.0
// How late training looks at what its iterations report. Private to train.
#pragma once

#include "gpu/stream.hpp"

namespace relidar {

/// What iteration i reports is looked at before iteration i + kReadbackLag is recorded.
/// The stream waits for that submission then anyway, to record into its slot again:
/// looking costs no wait, and a fixed lag leaves every training repeatable.
inline constexpr int kReadbackLag = static_cast<int>(Stream::Impl::kSlots);

}  // namespace relidar
