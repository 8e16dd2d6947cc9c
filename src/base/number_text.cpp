// SPDX-License-Identifier: Apache-2.0
#include "base/number_text.hpp"

#include <array>
#include <charconv>
#include <cmath>

namespace relidar {
namespace {

template <class T>
std::string shortest_text(T value) {
    if (std::isnan(value)) return "nan";  // Ignores the sign of a NaN.
    std::array<char, 32> buffer;          // The longest text has 24 characters: -2.2250738585072014e-308.
    const std::to_chars_result end = std::to_chars(buffer.data(), buffer.data() + buffer.size(), value);
    const std::string text(buffer.data(), end.ptr);
    const bool is_integer_text = std::isfinite(value) && text.find_first_of(".e") == std::string::npos;
    return is_integer_text ? text + ".0" : text;
}

}  // namespace

std::string number_text(double value) { return shortest_text(value); }
std::string number_text(float value) { return shortest_text(value); }

}  // namespace relidar
