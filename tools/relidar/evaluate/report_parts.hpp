// SPDX-License-Identifier: Apache-2.0
// Creates the parts of the HTML report that describe scored frames: 3D points, range
// errors, and explanations of the metrics.
#pragma once

#include <string>
#include <vector>

#include <relidar/score/metrics.hpp>
#include <relidar/score/report.hpp>

namespace relidar {
struct Config;
struct EvaluationResult;
struct ScoredFrame;
}  // namespace relidar

namespace relidar::cli {

/// Creates a 3D view that shows the real and the simulated points of a frame together.
/// All points are in the sensor frame at the time of the frame.
/// @param label_of_real_points label of the real points
ReportView make_3d_view_of_real_and_rendered_points(const ScoredFrame& frame, const Config& config,
                                                    const std::string& title,
                                                    const std::string& label_of_real_points);

/// Creates a bar chart of the range errors. Each bar shows the shares of rays with small
/// and large errors, for one interval of the real range.
ReportBars make_error_by_range_chart(const EvaluationResult& evaluation, const std::string& title);

/// Returns the most important metrics with their explanations.
std::vector<ReportKeyMetric> get_key_metrics();

/// Returns a sentence about the quality of a run. Example: "half of all ranges are within
/// 2.1 cm of the real ones, and 97.3 % of all rays return or drop as they did". The text
/// is empty if the metrics are missing.
std::string make_sentence_about_mean_quality(const MetricValues& mean_metrics);

}  // namespace relidar::cli
