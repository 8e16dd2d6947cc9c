// SPDX-License-Identifier: Apache-2.0
// Builds the HTML report of a run from the results of training and evaluation.
#pragma once

#include <string>

#include <relidar/score/report.hpp>

namespace relidar {
struct Run;
struct TrainResult;
class Device;
struct Evaluation;
}  // namespace relidar

namespace relidar::cli {

/// Returns a report with facts, loss curves and kernel times of the training.
/// add_evaluation() extends its summary.
Report make_report(const Run& run, const TrainResult& result, const Device& device,
                   const std::string& command_line);

/// Labels of a set of scored frames.
struct EvaluationTitle {
    std::string column;  ///< Column title in the metric table, such as "held out".
    std::string real;    ///< Caption of the real images: "real" or "exact".
};
/// Adds a column of metrics, a table of timings, errors by range, and points and pictures
/// of one frame. The first call also extends the summary.
void add_evaluation(Report& report, const Evaluation& evaluation, const Run& run,
                    const EvaluationTitle& title);

/// Returns a report of an evaluation without its training.
Report make_evaluation_report(const Run& run, const Evaluation& evaluation, const Device& device,
                              const std::string& command_line);

}  // namespace relidar::cli
