// SPDX-License-Identifier: Apache-2.0
// Finds similar names for error messages. Uses the edit distance of Levenshtein. Two
// exchanged neighbouring letters count as one error:
//   d(i, j) = min(d(i-1, j) + 1, d(i, j-1) + 1, d(i-1, j-1) + [a_i != b_j],
//                 d(i-2, j-2) + 1 if a_i = b_{j-1} and a_{i-1} = b_j)
#include <relidar/base/error.hpp>

#include <algorithm>
#include <cctype>
#include <numeric>
#include <utility>

#include <fmt/format.h>

namespace relidar {
namespace {

bool is_same_letter(char first, char second) {
    return std::tolower(static_cast<unsigned char>(first)) ==
           std::tolower(static_cast<unsigned char>(second));
}

/// Returns the least number of letters to replace, insert, remove, or exchange with the
/// next one, to turn one word into the other. row[j]: this number for the first i letters
/// of one word and the first j of the other. Keeps only rows i - 2, i - 1 and i.
std::size_t edit_distance(std::string_view first, std::string_view second) {
    std::vector<std::size_t> two_rows_before, row_before(second.size() + 1), row(second.size() + 1);
    std::iota(row_before.begin(), row_before.end(), std::size_t{0});
    for (std::size_t i = 1; i <= first.size(); ++i) {
        row[0] = i;
        for (std::size_t j = 1; j <= second.size(); ++j) {
            const bool is_equal = is_same_letter(first[i - 1], second[j - 1]);
            const std::size_t if_replaced = row_before[j - 1] + (is_equal ? 0 : 1);
            row[j] = std::min({row_before[j] + 1, row[j - 1] + 1, if_replaced});
            const bool is_swapped = i > 1 && j > 1 && is_same_letter(first[i - 1], second[j - 2]) &&
                                    is_same_letter(first[i - 2], second[j - 1]);
            if (is_swapped) row[j] = std::min(row[j], two_rows_before[j - 2] + 1);
        }
        two_rows_before = std::exchange(row_before, row);
    }
    return row_before[second.size()];
}

bool contains_text(std::string_view text, std::string_view substring) {
    return substring.size() >= 3 && std::search(text.begin(), text.end(), substring.begin(), substring.end(),
                                                is_same_letter) != text.end();
}

}  // namespace

std::string nearest_name(std::string_view query, const std::vector<std::string>& names) {
    const auto best = std::min_element(names.begin(), names.end(),
                                       [&](const std::string& first, const std::string& second) {
                                           return edit_distance(query, first) < edit_distance(query, second);
                                       });
    return best == names.end() ? std::string() : *best;
}

std::string did_you_mean(std::string_view query, const std::vector<std::string>& names,
                         std::string_view quote, std::string_view otherwise) {
    std::vector<std::string> similar_names;
    for (const std::string& name : names) {
        // One name contains the other, or at most 2/5 of the letters differ.
        const std::size_t max_distance =
            std::max<std::size_t>(1, 2 * std::max(query.size(), name.size()) / 5);
        if (edit_distance(query, name) <= max_distance || contains_text(query, name) ||
            contains_text(name, query))
            similar_names.push_back(name);
    }
    if (similar_names.empty()) return std::string(otherwise);
    return fmt::format(", did you mean {}{}{}?", quote, nearest_name(query, similar_names), quote);
}

std::optional<std::string> find_name(std::string_view query, const std::vector<std::string>& names) {
    for (const std::string& name : names)
        if (std::equal(query.begin(), query.end(), name.begin(), name.end(), is_same_letter)) return name;
    return std::nullopt;
}

}  // namespace relidar
