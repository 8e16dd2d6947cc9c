// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include <relidar/score/report.hpp>

namespace relidar {
struct Run;
struct TrainResult;
class Device;
struct Evaluation;
}  // namespace relidar

namespace relidar::cli {

std::vector<ReportKeyMetric> key_metrics();

Report training_report(const Run& run, const TrainResult& trained, const Device& device,
                       const std::string& args);

struct EvaluationLabels {
    std::string column;  ///< Title of the column in the metric table, such as "held out".
    std::string real;    ///< Caption of the real images: "real" or "exact".
};
/// Adds the scores of a sensor to a report: a column of metrics, tables, and an example
/// frame. The first call also adds the quality of the result to the summary.
void add_evaluation(Report& report, const Evaluation& result, const Run& run, const EvaluationLabels& labels);

Report evaluation_report(const Run& run, const Evaluation& result, const Device& device,
                         const std::string& args);

}  // namespace relidar::cli
