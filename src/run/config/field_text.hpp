// SPDX-License-Identifier: Apache-2.0
// Numbers are written in the shortest form from which the same value is read again.
// Private to config.
#pragma once

#include <algorithm>
#include <charconv>
#include <cmath>
#include <optional>
#include <string>
#include <type_traits>

#include <fmt/format.h>

#include "base/list_text.hpp"
#include "base/number_text.hpp"
#include "run/config/fields.hpp"

namespace relidar::config {

/// written in quotes in a TOML file
template <class T>
constexpr bool is_text = std::is_same_v<T, std::string> || std::is_enum_v<T>;

template <class T>
std::string format_setting(const T& value, const SettingValueRange& accepted_values) {
    if constexpr (std::is_enum_v<T>) return accepted_values.choices.at(static_cast<std::size_t>(value));
    else if constexpr (std::is_floating_point_v<T>) return number_text(value);
    else return fmt::format("{}", value);
}

/// For example "a number >= 0", "an integer in 1..64", "one of ray, surfel".
template <class T>
std::string describe_range(const SettingValueRange& accepted_values) {
    if constexpr (std::is_same_v<T, bool>) return "true or false";
    if (accepted_values.several)
        return fmt::format("some of {}, separated by commas", fmt::join(accepted_values.choices, ", "));
    if (!accepted_values.choices.empty())
        return fmt::format("one of {}", fmt::join(accepted_values.choices, ", "));
    if constexpr (is_text<T>) return "text";
    const std::string kind = std::is_integral_v<T> ? "an integer" : "a number";
    // Without an upper limit, the text states only the lower limit.
    const bool open_end =
        accepted_values.high >= (std::is_integral_v<T> ? kMaxCount : std::numeric_limits<double>::max());
    const char* above = accepted_values.above_low ? "above" : "of at least";
    if (open_end) return fmt::format("{} {} {:.15g}", kind, above, accepted_values.low);
    if (accepted_values.above_low)
        return fmt::format("{} above {:.15g} and at most {:.15g}", kind, accepted_values.low,
                           accepted_values.high);
    return fmt::format("{} from {:.15g} to {:.15g}", kind, accepted_values.low, accepted_values.high);
}

/// Parses a finite number within the accepted range. Returns nothing for other text.
template <class T>
std::optional<T> parse_in_range(const std::string& text, const SettingValueRange& accepted_values) {
    T parsed{};
    const char* begin = text.data();
    const char* end = begin + text.size();
    // std::from_chars() does not accept a plus sign.
    if (begin != end && *begin == '+') ++begin;
    const auto [stop, error] = std::from_chars(begin, end, parsed);
    if (begin == end || error != std::errc() || stop != end) return std::nullopt;
    if constexpr (std::is_floating_point_v<T>) {
        if (!std::isfinite(parsed)) return std::nullopt;
    }
    const auto number = static_cast<double>(parsed);
    if (number > accepted_values.high || number < accepted_values.low ||
        (accepted_values.above_low && number <= accepted_values.low))
        return std::nullopt;
    return parsed;
}

/// Parses the text of a setting. Returns nothing if the value is not accepted.
template <class T>
std::optional<T> parse_setting(const std::string& text, const SettingValueRange& accepted_values) {
    const auto find = [&](const std::string& word) {
        return std::find(accepted_values.choices.begin(), accepted_values.choices.end(), word);
    };
    const auto choice = find(text);
    const auto is_choice = [&](const std::string& word) {
        return find(word) != accepted_values.choices.end();
    };
    if (accepted_values.several ? !std::ranges::all_of(split_list(text), is_choice)
                                : !accepted_values.choices.empty() && choice == accepted_values.choices.end())
        return std::nullopt;
    // The choices are in the order of the enumerators.
    if constexpr (std::is_enum_v<T>) {
        return static_cast<T>(choice - accepted_values.choices.begin());
    } else if constexpr (std::is_same_v<T, std::string>) {
        if (text.find_first_of("\n\r") != std::string::npos) return std::nullopt;
        return text;
    } else if constexpr (std::is_same_v<T, bool>) {
        if (text != "true" && text != "false") return std::nullopt;
        return text == "true";
    } else {
        return parse_in_range<T>(text, accepted_values);
    }
}

}  // namespace relidar::config
