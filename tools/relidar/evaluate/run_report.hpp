// SPDX-License-Identifier: Apache-2.0
// Builds the HTML report of a run from the results of its training and its evaluation.
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

/// Returns a report with facts, loss curves and kernel times of a training.
/// add_evaluation() adds the scores to this report.
Report make_report(const Run& run, const TrainResult& result, const Device& device,
                   const std::string& command_line);

/// Texts that describe a set of scored frames in the report.
struct EvaluationTitle {
    std::string column;  ///< Title of the column in the metric table, such as "held out".
    std::string real;    ///< Caption of the real images: "real" or "exact".
};
/// Adds the scores of an evaluation to a report: a column of metrics, a table of timings,
/// errors by range, moving objects, and points and pictures of one frame. The first call
/// also extends the summary of the report.
void add_evaluation(Report& report, const Evaluation& evaluation, const Run& run,
                    const EvaluationTitle& title);

/// Returns a report about an evaluation only, without facts about the training.
Report make_evaluation_report(const Run& run, const Evaluation& evaluation, const Device& device,
                              const std::string& command_line);

}  // namespace relidar::cli
