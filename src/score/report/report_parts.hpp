// SPDX-License-Identifier: Apache-2.0
// Declares parts of the report that are implemented in separate files. Private to the
// report.
#pragma once

#include <cstddef>
#include <string>

#include <relidar/score/report.hpp>

namespace relidar::report_detail {

/// Returns the HTML code of a 3D view of point clouds. The code contains the points as
/// base64 text.
/// @param n_views  number of views on the page; they share the size limit of the page
std::string make_3d_view_html(const ReportView& view, std::size_t n_views);
/// Returns the JavaScript code that draws all 3D views of a page.
std::string make_3d_view_script();

/// Returns stacked bars as an HTML table that also contains the values.
std::string make_stacked_bars_html(const ReportBars& bars);

}  // namespace relidar::report_detail
