// SPDX-License-Identifier: Apache-2.0
// What a report shows of scored frames beside pictures and numbers: points in 3D, errors
// by range, what numbers mean.
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

/// Real beside simulated points of a frame, as they lie about the sensor at the frame's
/// time. @param real  what the real one is called
ReportView points_beside(const ScoredFrame& frame, const Config& config, const std::string& title,
                         const std::string& real);

/// How far simulated ranges are off, by the real range, over all frames.
ReportBars errors_by_range(const Evaluation& evaluation, const std::string& title);

/// The metrics a person looks at first.
std::vector<ReportKeyMetric> key_metrics();

/// "half of all ranges are within 2.1 cm of the real ones, and 97.3 % of all rays return
/// or drop as they did"; empty where nobody knows.
std::string how_good(const MetricRow& mean);

}  // namespace relidar::cli
