// SPDX-License-Identifier: Apache-2.0
// Parts of the HTML page. Private to the report.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include <relidar/score/report.hpp>

namespace relidar::report {

/// Replaces the characters that cannot be in an HTML element or a quoted attribute.
std::string escape_html(std::string_view text);
/// Four significant digits, for example 6.458, 0.03402 or 1.2e-07; a dash for NaN.
std::string format_number(double value);
std::string png_data_url(const Image& image);

/// Number of colours of curves. Further curves repeat the colours. The CSS classes of the
/// colours are c0 ... c7.
inline constexpr int kChartColours = 8;

/// Draws curves in one chart with common axes, and returns the chart as SVG. The y axis
/// is logarithmic if all values are positive and span more than a factor of 4. Values
/// that are not finite leave gaps. Long curves are drawn faint, and their running mean is
/// drawn as a solid line.
/// @throws DataError if x and y of a curve differ in length
std::string draw_svg_chart(const std::vector<const ReportCurve*>& curves, int width, int height);
bool has_running_mean(const ReportCurve& curve);

/// Returns a 3D view of one or more clouds as HTML. Its points are base64 text, which the
/// script of the page draws.
/// @param n_views  number of views on the page; they share the size limit of the page
std::string view_html(const ReportView& view, std::size_t n_views);
std::string view_script();

}  // namespace relidar::report
