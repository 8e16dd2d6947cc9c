// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include <nlohmann/json_fwd.hpp>

#include <relidar/score/evaluation.hpp>

namespace relidar::cli {

class MpiProcessGroup;

/// The five most important scores, one per line. A missing score is left out.
std::string format_scores(const Evaluation& result);
/// The 20 moving boxes with the worst scores, below the column titles.
std::vector<std::vector<std::string>> worst_actor_rows(const Evaluation& result);
/// Scores at depth edges, below the column titles: one row each for edges/*,
/// edges_repeat/* and smooth/*. A region without pixels is left out.
std::vector<std::vector<std::string>> edge_rows(const Evaluation& result);
/// @param baseline its means are shown too; may be null
std::string format_metrics(const Evaluation& result, const Evaluation* baseline = nullptr);

/// @return in the first process, the scores of all frames, without the images of other
/// processes; in the other processes, `local_evaluation`
Evaluation gather_evaluation(const Evaluation& local_evaluation, const MpiProcessGroup& ranks);

nlohmann::ordered_json frames_json(const Evaluation& result);

/// How the scores were computed, for metrics.json.
struct EvaluationProvenance {
    std::string run;  ///< Path of the run. Empty if a baseline was scored without a run.
    std::string device;
    std::uint64_t peak_device_bytes = 0;
    double seconds = 0.0;
    const Evaluation* baseline = nullptr;
};
EvaluationProvenance describe_source(const Run& run, const Device& device, double seconds = 0.0);
std::string metrics_json(const Evaluation& result, const Config& config, const EvaluationProvenance& source);

}  // namespace relidar::cli
