// SPDX-License-Identifier: Apache-2.0
// Lists as people read and write them.
#pragma once

#include <algorithm>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace relidar {

/// "3, 4, 7", or of more than `most` numbers "3, 4, 7, ... 91 (78 in all)".
inline std::string list_text(const std::vector<int>& numbers, std::size_t most = 6) {
    if (numbers.size() <= most) return fmt::format("{}", fmt::join(numbers, ", "));
    return fmt::format("{}, ... {} ({} in all)",
                       fmt::join(numbers.begin(), numbers.begin() + std::ptrdiff_t(most) - 1, ", "),
                       numbers.back(), numbers.size());
}

/// The words of "a, b,c", blanks left out.
inline std::vector<std::string> words_of(const std::string& list) {
    std::vector<std::string> words{""};
    for (const char c : list) {
        if (c == ',') words.emplace_back();
        else if (c != ' ') words.back() += c;
    }
    std::erase(words, "");
    return words;
}

}  // namespace relidar
