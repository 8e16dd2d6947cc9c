// SPDX-License-Identifier: Apache-2.0
// Converts texts, numbers and images to text for HTML pages: escaped text, readable
// numbers, data URLs. Private to the report.
#pragma once

#include <string>
#include <string_view>

#include <relidar/base/images.hpp>

namespace relidar::report {

/// For inside an HTML element or a quoted attribute.
std::string escape_html(std::string_view text);

/// Four significant digits, for example 6.458, 0.03402 or 1.2e-07; a dash for NaN.
std::string format_number(double value);

/// data:image/png;base64,...
std::string png_data_url(const Image& image);

}  // namespace relidar::report
