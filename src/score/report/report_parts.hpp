// SPDX-License-Identifier: Apache-2.0
// Parts of the report with files of their own. Private to export.
#pragma once

#include <cstddef>
#include <string>

#include <relidar/score/report.hpp>

namespace relidar::export_detail {

/// Canvases of a view's clouds, with their points as base64. @param n_views  of the page,
/// among which its megabytes are divided
std::string view_html(const ReportView& view, std::size_t n_views);
/// The script that draws all views of a page.
std::string view_script();

/// Stacked bars as a table, which reads as numbers too.
std::string bars_html(const ReportBars& bars);

}  // namespace relidar::export_detail
