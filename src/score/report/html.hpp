// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <string_view>

#include <relidar/base/images.hpp>

namespace relidar::report {

/// For inside an HTML element or a quoted attribute.
std::string escape_html(std::string_view text);

/// Four significant digits, for example 6.458, 0.03402 or 1.2e-07; a dash for NaN.
std::string format_number(double value);

std::string png_data_url(const Image& image);

}  // namespace relidar::report
