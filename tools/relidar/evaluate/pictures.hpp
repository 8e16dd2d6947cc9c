// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include <relidar/base/images.hpp>
#include <relidar/score/report.hpp>

namespace relidar {
struct Evaluation;
struct ScoredFrame;
}  // namespace relidar

namespace relidar::cli {

/// Range, intensity (if the log has intensities) and ray-drop.
std::vector<ReportFigure> comparison_figures(const ScoredFrame& frame, const std::string& title,
                                             const std::string& real_caption, double max_range_m);

/// FOLDER/{range,intensity,drop}_000123.png: the real image, the rendered image and the
/// error, from top to bottom. Without intensity if the log has none.
void write_comparison(const std::filesystem::path& folder, const ScoredFrame& frame, double max_range_m);

Image draw_ranges(const ScoredFrame& frame, double max_range_m);

}  // namespace relidar::cli
