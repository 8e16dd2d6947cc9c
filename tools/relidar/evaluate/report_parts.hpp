// SPDX-License-Identifier: Apache-2.0
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

/// Real and simulated points in the sensor frame at the time of the frame.
ReportView make_3d_view(const ScoredFrame& frame, const Config& config, const std::string& title,
                        const std::string& real_label);

/// shares of rays with small and large errors, by intervals of the real range
ReportBars error_by_range(const Evaluation& result, const std::string& title);

std::vector<ReportKeyMetric> key_metrics();

std::string quality_sentence(const MetricValues& mean_metrics);

}  // namespace relidar::cli
