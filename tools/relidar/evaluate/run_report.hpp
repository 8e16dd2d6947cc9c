// SPDX-License-Identifier: Apache-2.0
// The HTML report of a run, put together from training and evaluation.
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

/// Facts, loss curves and kernel times of training. The summary goes on with
/// add_evaluation().
Report make_report(const Run& run, const TrainResult& result, const Device& device,
                   const std::string& command_line);

/// What a set of scored frames is called.
struct EvaluationTitle {
    std::string column;  ///< of the metric table: "held out"
    std::string real;    ///< caption of the real images: "real", "exact"
};
/// Adds a metric column, a timing table, errors by range, and points and pictures of one
/// frame. What the first adds is told in the summary.
void add_evaluation(Report& report, const Evaluation& evaluation, const Run& run,
                    const EvaluationTitle& title);

/// The report of an evaluation alone.
Report make_evaluation_report(const Run& run, const Evaluation& evaluation, const Device& device,
                              const std::string& command_line);

}  // namespace relidar::cli
