// SPDX-License-Identifier: Apache-2.0
// Parts of the HTML report about scored frames.
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

/// Real and simulated points in the sensor frame at the time of the frame.
ReportView make_3d_view_of_real_and_rendered_points(const ScoredFrame& frame, const Config& config,
                                                    const std::string& title,
                                                    const std::string& label_of_real_points);

/// shares of rays with small and large errors, by intervals of the real range
ReportBars make_error_by_range_chart(const EvaluationResult& evaluation, const std::string& title);

std::vector<ReportKeyMetric> get_key_metrics();

/// Empty if the metrics are missing.
std::string make_sentence_about_mean_quality(const MetricValues& mean_metrics);

}  // namespace relidar::cli
