// SPDX-License-Identifier: Apache-2.0
// Declares parts of the report that are implemented in separate files. Private to the
// report.
#pragma once

#include <cstddef>
#include <string>

#include <relidar/score/report.hpp>

namespace relidar::report_detail {

/// Returns the HTML canvases of a 3D view. The points of the view's clouds are stored as
/// base64 text.
/// @param n_views  number of views on the page; the size limit of the page is divided
/// among them
std::string make_view_html(const ReportView& view, std::size_t n_views);
/// Returns the JavaScript code that draws all 3D views of a page.
std::string make_view_script();

/// Returns stacked bars as an HTML table that also shows the numbers.
std::string make_bars_html(const ReportBars& bars);

}  // namespace relidar::report_detail
