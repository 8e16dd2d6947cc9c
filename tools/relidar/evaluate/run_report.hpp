// SPDX-License-Identifier: Apache-2.0
// Builds the HTML report of a run from the results of its training and its evaluation.
#pragma once

#include <string>

#include <relidar/score/report.hpp>

namespace relidar {
struct TrainedRun;
struct TrainResult;
class Device;
struct EvaluationResult;
}  // namespace relidar

namespace relidar::cli {

/// Facts, loss curves and kernel times, without scores.
Report make_training_report(const TrainedRun& run, const TrainResult& result, const Device& device,
                            const std::string& command_line);

struct EvaluationLabels {
    std::string column;  ///< Title of the column in the metric table, such as "held out".
    std::string real;    ///< Caption of the real images: "real" or "exact".
};
/// The first call also extends the summary of the report.
void add_evaluation_to_report(Report& report, const EvaluationResult& evaluation, const TrainedRun& run,
                              const EvaluationLabels& labels);

/// Without facts about the training.
Report make_evaluation_report(const TrainedRun& run, const EvaluationResult& evaluation, const Device& device,
                              const std::string& command_line);

}  // namespace relidar::cli
