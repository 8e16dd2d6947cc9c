// SPDX-License-Identifier: Apache-2.0
// Counts the dots in each key of a TOML text, except in quoted texts and comments. In
// multi-line texts, the count may be too high but never too low.
#include "base/toml_depth.hpp"

#include <algorithm>

#include "base/fail.hpp"

namespace relidar {
namespace {

constexpr int kMostParts = 8, kDeepest = 8;

/// Returns the position after a quoted text. If the closing quote is missing, returns the
/// end of the line.
std::size_t skip_quoted(std::string_view text, std::size_t quote_position) {
    const char quote = text[quote_position++];
    for (; quote_position < text.size() && text[quote_position] != quote && text[quote_position] != '\n';
         ++quote_position) {
        if (text[quote_position] == '\\' && quote == '"' && quote_position + 1 < text.size() &&
            text[quote_position + 1] != '\n')
            ++quote_position;
    }
    return quote_position < text.size() && text[quote_position] == quote ? quote_position + 1
                                                                         : quote_position;
}

}  // namespace

void check_toml_depth(std::string_view toml_text, const std::string& name) {
    int line = 1, parts = 1, depth = 0;
    for (std::size_t at = 0; at < toml_text.size();) {
        const char c = toml_text[at];
        if (c == '"' || c == '\'') {
            at = skip_quoted(toml_text, at);
            continue;
        }
        if (c == '#') {
            at = std::min(toml_text.find('\n', at), toml_text.size());
            continue;
        }
        // Counts the parts of a dotted key. Other separators begin a key or value.
        if (c == '.') ++parts;
        else if (c == '\n' || c == '=' || c == ',' || c == '{' || c == '[') parts = 1;
        if (c == '{' || c == '[') ++depth;
        if (c == '}' || c == ']') depth = std::max(depth - 1, 0);
        if (parts > kMostParts)
            fail("{}:{}: found a key with more than {} parts, expected two, such as train.iterations", name,
                 line, kMostParts);
        if (depth > kDeepest)
            fail("{}:{}: found more than {} nested brackets; a closing bracket may be missing", name, line,
                 kDeepest);
        line += c == '\n';
        ++at;
    }
}

}  // namespace relidar
