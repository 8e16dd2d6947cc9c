// SPDX-License-Identifier: Apache-2.0
// How what takes longer than a moment says how far it is.
#pragma once

#include <functional>
#include <string_view>

namespace relidar {

/// Called now and then by work that may take seconds, from the thread that started it. May be empty: nothing is told.
/// @param what  is being done, in a few words @param done  share of it, 0..1
using Progress = std::function<void(std::string_view what, double done)>;

}  // namespace relidar
