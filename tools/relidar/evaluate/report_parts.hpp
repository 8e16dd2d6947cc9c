// SPDX-License-Identifier: Apache-2.0
// Creates parts of the HTML report about scored frames: points in 3D, range errors, and
// explanations of the metrics.
#pragma once

#include <string>
#include <vector>

#include <relidar/score/metrics.hpp>
#include <relidar/score/report.hpp>

namespace relidar {
struct Config;
struct Evaluation;
struct ScoredFrame;
}  // namespace relidar

namespace relidar::cli {

/// Creates a 3D view of the real and the simulated points of a frame. The points are in
/// the sensor frame at the time of the frame.
/// @param real label of the real points
ReportView compare_points(const ScoredFrame& frame, const Config& config, const std::string& title,
                          const std::string& real);

/// Returns bars that show the share of rays with small and large range errors. The rays
/// of all frames are grouped by their real range.
ReportBars errors_by_range(const Evaluation& evaluation, const std::string& title);

/// Returns the most important metrics with their explanations.
std::vector<ReportKeyMetric> key_metrics();

/// Returns a sentence about the quality of a run, such as "half of all ranges are within
/// 2.1 cm of the real ones, and 97.3 % of all rays return or drop as they did". Returns
/// an empty text if the metrics are missing.
std::string how_good(const MetricRow& mean);

}  // namespace relidar::cli
