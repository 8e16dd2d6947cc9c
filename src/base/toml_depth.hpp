// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <string>

#include "base/fail.hpp"
#include "base/files.hpp"

namespace relidar {

/// A TOML library destroys nested tables recursively, so a key with forty thousand dots
/// would overflow the stack. Keys of our settings have two parts. The library itself
/// limits nested brackets.
inline void check_toml_depth(const std::string& toml_text, const std::string& name) {
    constexpr std::ptrdiff_t kMaxDots = 1000;
    int number = 0;
    for (const std::string& line : split_lines(toml_text))
        if (++number; std::ranges::count(line, '.') > kMaxDots)
            fail("{}:{}: found a line with more than {} dots, expected keys such as train.iterations", name,
                 number, kMaxDots);
}

}  // namespace relidar
