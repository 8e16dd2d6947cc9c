// SPDX-License-Identifier: Apache-2.0
// Parts of the report in separate files. Private to the report.
#pragma once

#include <cstddef>
#include <string>

#include <relidar/score/report.hpp>

namespace relidar::report_detail {

/// The points are base64 text.
/// @param n_views  number of views on the page; they share the size limit of the page
std::string make_3d_view_html(const ReportView& view, std::size_t n_views);
std::string make_3d_view_script();

std::string make_stacked_bars_html(const ReportBars& bars);

}  // namespace relidar::report_detail
