// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <string>

#include <relidar/score/report.hpp>

namespace relidar::report {

/// The points are base64 text.
/// @param n_views  number of views on the page; they share the size limit of the page
std::string view_html(const ReportView& view, std::size_t n_views);
std::string view_script();

}  // namespace relidar::report
