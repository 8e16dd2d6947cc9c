// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include <nlohmann/json_fwd.hpp>

#include <relidar/score/evaluation.hpp>

namespace relidar::cli {

class TerminalProgress;
class MpiProcessGroup;

/// After Ctrl-C, the callback throws an Error with exit code 130.
relidar::ProgressReporter make_interruptible_progress_callback(TerminalProgress& terminal_progress);

/// The five most important scores, one per line. A missing score is left out.
std::string format_score_summary(const EvaluationResult& evaluation);
/// The 20 moving boxes with the worst scores, below the column titles.
std::vector<std::vector<std::string>> make_worst_actor_table_rows(const EvaluationResult& evaluation);
/// @param baseline its means are shown too; may be null
std::string format_metric_tables(const EvaluationResult& evaluation,
                                 const EvaluationResult* baseline = nullptr);

/// @return in the first process, the scores of all frames, without the images of other
/// processes; in the other processes, `local_evaluation`
EvaluationResult gather_evaluation_from_ranks(const EvaluationResult& local_evaluation,
                                              const MpiProcessGroup& ranks);

/// for metrics.json and for messages between MPI processes
nlohmann::ordered_json make_scored_frames_json(const EvaluationResult& evaluation);

/// How the scores were computed, for metrics.json.
struct EvaluationProvenance {
    std::string run;  ///< Path of the run. Empty if a baseline was scored without a run.
    std::string device;
    std::uint64_t peak_device_bytes = 0;
    double seconds = 0.0;
    const EvaluationResult* baseline = nullptr;
};
std::string make_metrics_json(const EvaluationResult& evaluation, const Config& config,
                              const EvaluationProvenance& provenance);

}  // namespace relidar::cli
