// SPDX-License-Identifier: Apache-2.0
// Text for HTML pages: escaping, readable numbers, images as data URLs. Private to the
// report.
#pragma once

#include <string>
#include <string_view>

#include <relidar/base/images.hpp>

namespace relidar::export_detail {

/// Escapes text for use inside an element or inside a quoted attribute.
std::string escape_html(std::string_view text);

/// Formats a number with four significant digits, for example 6.458, 0.03402 or 1.2e-07.
/// Returns a dash for NaN.
std::string format_number(double value);

/// Encodes bytes as base64 (RFC 4648, with padding).
std::string base64(const std::vector<std::uint8_t>& bytes);

/// Returns an image as a URL of the form data:image/png;base64,...
std::string png_data_url(const Image& image);

}  // namespace relidar::export_detail
