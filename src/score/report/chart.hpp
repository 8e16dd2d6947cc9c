// SPDX-License-Identifier: Apache-2.0
// Line charts as inline SVG for the report. Private to export.
#pragma once

#include <string>
#include <vector>

#include <relidar/score/report.hpp>

namespace relidar::export_detail {

/// Colours a chart has before it repeats them; style classes c0 ... c7.
inline constexpr int kChartColours = 8;

/// SVG of curves over common axes. The y axis is logarithmic where all values are
/// positive and span more than a factor of 4. Values that are not finite leave gaps.
/// Curves of many points are drawn faint, with their running mean solid.
/// @throws DataError where x and y of a curve differ in length
std::string svg_chart(const std::vector<const ReportCurve*>& curves, int width, int height);

/// Whether svg_chart draws running means for any of these curves.
bool has_running_mean(const std::vector<const ReportCurve*>& curves);

}  // namespace relidar::export_detail
