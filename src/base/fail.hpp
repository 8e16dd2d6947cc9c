// SPDX-License-Identifier: Apache-2.0
// Errors in one line: what failed, what was found, what was expected.
#pragma once

#include <relidar/base/error.hpp>

#include <fmt/format.h>

#include <utility>

namespace relidar {

/// Throws the error E with the formatted message.
template <class E = DataError, class... T>
[[noreturn]] void fail(fmt::format_string<T...> message, T&&... values) {
    throw E(fmt::format(message, std::forward<T>(values)...));
}

}  // namespace relidar
