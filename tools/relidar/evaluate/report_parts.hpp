// SPDX-License-Identifier: Apache-2.0
// Parts of the HTML report about scored frames: points in 3D, errors by range, and
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

/// Creates the 3D view of the real and the simulated points of a frame, in the sensor
/// frame at the frame's time.
/// @param real label of the real points
ReportView points_beside(const ScoredFrame& frame, const Config& config, const std::string& title,
                         const std::string& real);

/// Returns the share of small and large range errors, grouped by real range, over all
/// frames.
ReportBars errors_by_range(const Evaluation& evaluation, const std::string& title);

/// Returns the most important metrics with their explanations.
std::vector<ReportKeyMetric> key_metrics();

/// Returns a sentence such as "half of all ranges are within 2.1 cm of the real ones, and
/// 97.3 % of all rays return or drop as they did". Returns an empty text if the metrics
/// are missing.
std::string how_good(const MetricRow& mean);

}  // namespace relidar::cli
