// SPDX-License-Identifier: Apache-2.0
// Text for HTML pages: escaping, numbers people can read, pictures as data URLs. Private
// to export.
#pragma once

#include <string>
#include <string_view>

#include <relidar/base/images.hpp>

namespace relidar::export_detail {

/// Text safe inside an element and inside a quoted attribute.
std::string escape_html(std::string_view text);

/// Four significant digits, e.g. 6.458, 0.03402, 1.2e-07; a dash for NaN.
std::string format_number(double value);

/// RFC 4648, with padding.
std::string base64(const std::vector<std::uint8_t>& bytes);

/// data:image/png;base64,...
std::string png_data_url(const Image& image);

}  // namespace relidar::export_detail
