// SPDX-License-Identifier: Apache-2.0
// Counts the dots in each key of a TOML text, without quoted texts and comments. In
// multi-line texts, the count may be too high but never too low.
#include "base/toml_depth.hpp"

#include <algorithm>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

namespace relidar {
namespace {

constexpr int kMostParts = 8, kDeepest = 8;

/// Returns the position after a quoted text. If the closing quote is missing, returns the
/// end of the line.
std::size_t skip_quoted(std::string_view text, std::size_t position) {
    const char quote = text[position++];
    for (; position < text.size() && text[position] != quote && text[position] != '\n'; ++position) {
        if (text[position] == '\\' && quote == '"' && position + 1 < text.size() &&
            text[position + 1] != '\n')
            ++position;
    }
    return position < text.size() && text[position] == quote ? position + 1 : position;
}

}  // namespace

void check_toml_depth(std::string_view text, const std::string& file) {
    int line = 1, parts = 1, depth = 0;
    for (std::size_t at = 0; at < text.size();) {
        const char c = text[at];
        if (c == '"' || c == '\'') {
            at = skip_quoted(text, at);
            continue;
        }
        if (c == '#') {
            at = std::min(text.find('\n', at), text.size());
            continue;
        }
        if (c == '.') ++parts;
        else if (c == '\n' || c == '=' || c == ',' || c == '{' || c == '[') parts = 1;
        if (c == '{' || c == '[') ++depth;
        if (c == '}' || c == ']') depth = std::max(depth - 1, 0);
        if (parts > kMostParts)
            throw DataError(fmt::format(
                "{}:{}: found a key with more than {} parts, expected settings with two parts such as "
                "train.iterations",
                file, line, kMostParts));
        if (depth > kDeepest)
            throw DataError(fmt::format(
                "{}:{}: found brackets that are nested more than {} deep, expected settings with one "
                "value each",
                file, line, kDeepest));
        line += c == '\n';
        ++at;
    }
}

}  // namespace relidar
