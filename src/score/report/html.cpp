// SPDX-License-Identifier: Apache-2.0
#include "html.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "base/base64.hpp"

namespace relidar::report {

std::string escape_html(std::string_view text) {
    std::string result;
    for (char c : text) {
        if (c == '&') result += "&amp;";
        else if (c == '<') result += "&lt;";
        else if (c == '>') result += "&gt;";
        else if (c == '"') result += "&quot;";
        else if (c == '\'') result += "&#39;";
        else result += c;
    }
    return result;
}

std::string format_number(double value) {
    if (std::isnan(value)) return "\u2013";
    const double size = std::abs(value);
    if (value == 0.0 || (size >= 1e-4 && size < 1e7)) {
        const int digits = value == 0.0 ? 0 : std::clamp(3 - int(std::floor(std::log10(size))), 0, 7);
        return fmt::format("{:.{}f}", value, digits);
    }
    return fmt::format("{:.3g}", value);
}

std::string png_data_url(const Image& image) {
    return "data:image/png;base64," + encode_base64(encode_png(image));
}

}  // namespace relidar::report
