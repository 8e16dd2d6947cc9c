// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include <relidar/score/report.hpp>

namespace relidar::report {

/// Number of colours of curves. Further curves repeat the colours. The CSS classes of the
/// colours are c0 ... c7.
inline constexpr int kChartColours = 8;

/// Draws curves in one chart with common axes, and returns the chart as SVG. The y axis
/// is logarithmic if all values are positive and span more than a factor of 4. Values
/// that are not finite leave gaps. Long curves are drawn faint, and their running mean is
/// drawn as a solid line.
/// @throws DataError if x and y of a curve differ in length
std::string draw_svg_chart(const std::vector<const ReportCurve*>& curves, int width, int height);

bool has_running_mean(const std::vector<const ReportCurve*>& curves);

}  // namespace relidar::report
