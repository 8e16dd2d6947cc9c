// SPDX-License-Identifier: Apache-2.0
// Compares what a message names, instead of its wording.
#pragma once

#include <cctype>
#include <string>
#include <string_view>

#include <gmock/gmock.h>

#include <relidar/log/log.hpp>

namespace relidar {
inline void PrintTo(const Note& note, std::ostream* out) { *out << note.text; }
}  // namespace relidar

namespace relidar::test {

inline bool ends_with_decimals(std::string_view part) {
    const std::size_t digits = part.find_last_not_of("0123456789");
    return digits != std::string_view::npos && digits + 1 < part.size() && part[digits] == '.';
}

inline std::string find_missing_part(std::string_view message, std::string_view parts) {
    const auto is_digit = [](char c) { return std::isdigit(static_cast<unsigned char>(c)) != 0; };
    const auto is_word = [](char c) { return std::isalnum(static_cast<unsigned char>(c)) || c == '_'; };
    constexpr std::string_view kGap = " ... ";
    std::size_t begin = 0;
    while (true) {
        const std::string_view part = parts.substr(0, parts.find(kGap));
        std::size_t at = message.find(part, begin);
        const auto cuts_word = [&] {
            const std::size_t end = at + part.size();
            if (at > 0 && is_word(message[at - 1]) && is_word(part.front())) return true;
            if (end == message.size() || !is_word(message[end]) || !is_word(part.back())) return false;
            return !is_digit(message[end]) || !ends_with_decimals(part);
        };
        while (at != std::string_view::npos && !part.empty() && cuts_word()) at = message.find(part, at + 1);
        if (at == std::string_view::npos) return std::string(part);
        begin = at + part.size();
        if (part.size() == parts.size()) return "";
        parts.remove_prefix(part.size() + kGap.size());
    }
}

/// Matches a message that contains, in this order, the parts that " ... " separates:
/// Names("a.csv ... line 3 ... 40 m ... 30 m"). A part does not begin or end within a
/// word or number of the message, but more decimals may follow: 1.1 matches 1.1000000237.
MATCHER_P(Names, parts, "contains \"" + std::string(parts) + "\"") {
    const std::string& message = arg;  // a text, or a note of a log
    const std::string missing = find_missing_part(message, parts);
    *result_listener << (missing.empty() ? "which has all parts" : "where \"" + missing + "\" is missing");
    return missing.empty();
}

/// Returns the texts of notes, one line each.
inline std::string join_lines(const Notes& notes) {
    std::string lines;
    for (const Note& note : notes) lines += note.text + "\n";
    return lines;
}

}  // namespace relidar::test
