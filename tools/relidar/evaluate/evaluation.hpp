// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include <nlohmann/json_fwd.hpp>

#include <relidar/score/evaluation.hpp>
#include "console.hpp"

namespace relidar::cli {

class MpiProcessGroup;

/// The five most important scores, one per line. A missing score is left out.
std::string format_scores(const Evaluation& result);
/// The 20 moving boxes with the worst scores, below the column titles.
TableRows worst_actor_rows(const Evaluation& result);
/// Scores of the points at depth edges and elsewhere, below the column titles. A region
/// without pixels is left out. If the sensor stands still in some frames, a row compares
/// successive real scans (edges_repeat/*), which shows the limit of any simulation.
TableRows edge_rows(const Evaluation& result);
/// All scores as tables, followed by the definitions of the metrics.
/// @param baseline its means are shown too; may be null
std::string format_metrics(const Evaluation& result, const Evaluation* baseline = nullptr);

/// @return in the first process, the scores of all frames, without the images of other
/// processes; in the other processes, `local_evaluation`
Evaluation gather_evaluation(const Evaluation& local_evaluation, const MpiProcessGroup& ranks);

/// The scores of each frame, for metrics.json and for other MPI processes.
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
/// The content of metrics.json.
std::string metrics_json(const Evaluation& result, const Config& config, const EvaluationProvenance& source);

}  // namespace relidar::cli
