// SPDX-License-Identifier: Apache-2.0
// Parts of the report that are implemented in separate files. Private to the report.
#pragma once

#include <cstddef>
#include <string>

#include <relidar/score/report.hpp>

namespace relidar::export_detail {

/// Returns the canvases of a view, with the points of its clouds as base64.
/// @param n_views  number of views of the page, which share its size limit
std::string view_html(const ReportView& view, std::size_t n_views);
/// Returns the script that draws all views of a page.
std::string view_script();

/// Returns stacked bars as a table that also shows the numbers.
std::string bars_html(const ReportBars& bars);

}  // namespace relidar::export_detail
