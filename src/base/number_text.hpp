// SPDX-License-Identifier: Apache-2.0
// Numbers in files, independent of the machine, the locale and library versions.
#pragma once

#include <array>
#include <charconv>
#include <cmath>
#include <concepts>
#include <optional>
#include <string>
#include <string_view>

namespace relidar {

/// Shortest decimal text that converts back to the same number. It has a point or an
/// exponent, so that TOML and JSON read it as a real number: "8.0", "1e-09", "-0.0".
/// Other values become "nan", "inf" or "-inf", which TOML accepts but JSON does not.
template <std::floating_point T>
std::string number_text(T value) {
    if (std::isnan(value)) return "nan";  // Ignores the sign of a NaN.
    std::array<char, 32> buffer;          // The longest text has 24 characters: -2.2250738585072014e-308.
    const std::to_chars_result end = std::to_chars(buffer.data(), buffer.data() + buffer.size(), value);
    const std::string text(buffer.data(), end.ptr);
    const bool is_integer_text = std::isfinite(value) && text.find_first_of(".e") == std::string::npos;
    return is_integer_text ? text + ".0" : text;
}

/// Parses a text that consists of digits, with a minus before them if T is signed.
/// Returns nothing for other texts and for numbers that do not fit into T.
template <std::integral T>
std::optional<T> parse_integer(std::string_view text, int base = 10) {
    T value = 0;
    const auto [stop, error] = std::from_chars(text.data(), text.data() + text.size(), value, base);
    const bool is_integer = error == std::errc() && stop == text.data() + text.size();
    return is_integer ? std::optional(value) : std::nullopt;
}

}  // namespace relidar
