// SPDX-License-Identifier: Apache-2.0
// Formats and parses lists in messages and settings.
#pragma once

#include <algorithm>
#include <string>
#include <vector>

#include <fmt/ranges.h>

namespace relidar {

/// "3, 4, 7", or shortened "3, 4, 7, ... 91 (78 in all)".
inline std::string list_text(const std::vector<int>& numbers, std::size_t max_count = 6) {
    if (numbers.size() <= max_count) return fmt::format("{}", fmt::join(numbers, ", "));
    return fmt::format("{}, ... {} ({} in total)",
                       fmt::join(numbers.begin(), numbers.begin() + std::ptrdiff_t(max_count) - 1, ", "),
                       numbers.back(), numbers.size());
}

inline std::vector<std::string> split_list(const std::string& comma_separated_list) {
    std::vector<std::string> words{""};
    for (const char c : comma_separated_list) {
        if (c == ',') words.emplace_back();
        else if (c != ' ') words.back() += c;
    }
    std::erase(words, "");
    return words;
}

}  // namespace relidar
