// SPDX-License-Identifier: Apache-2.0
// Formats the scores of an evaluation (<relidar/score/evaluation.hpp>) for the terminal
// and for files.
#pragma once

#include <string>

#include <nlohmann/json_fwd.hpp>

#include <relidar/score/evaluation.hpp>

namespace relidar::cli {

class Progress;
class Ranks;

/// Returns a callback that shows the progress of an evaluation. After Ctrl-C the callback
/// throws an Error with exit code 130, which ends the evaluation.
relidar::Progress stop_on_interrupt(Progress& progress);

/// Returns the five most important scores for the terminal, one per line. A score is left
/// out if the evaluation does not have it.
std::string score_summary(const Evaluation& evaluation);
/// Returns a table of the 20 worst moving boxes. The first row contains the titles.
std::vector<std::vector<std::string>> actor_rows(const Evaluation& evaluation);
/// Returns tables of all metrics for the terminal. They show the mean, lowest and highest
/// value over the frames, errors by region, and the meaning of each metric.
/// @param baseline if not null, its means are shown too
std::string metric_table(const Evaluation& evaluation, const Evaluation* baseline = nullptr);

/// Combines the frames that several processes have scored.
/// @return in the first process: the evaluation of all frames, where frames of other
/// processes have no images; in the other processes: `mine`
Evaluation joined(const Evaluation& mine, const Ranks& ranks);

/// Returns the scored frames as JSON objects. Each object holds the frame number, LiDAR,
/// time, number of rays, tracing time, metrics and the scores of each moving box. Used in
/// metrics.json and in messages between processes.
nlohmann::ordered_json frames_json(const Evaluation& evaluation);

/// Origin of the scores, which metrics.json stores in addition to the scores.
struct MetricsOrigin {
    std::string run;  ///< Path of the run. It is empty if a baseline was scored without a run.
    std::string device;
    std::uint64_t peak_device_bytes = 0;
    double seconds = 0.0;
    const Evaluation* baseline = nullptr;
};
/// Returns the text of metrics.json. It contains the scores of each frame, their means,
/// the protocol, timings, device and memory.
std::string metrics_json(const Evaluation& evaluation, const Config& config, const MetricsOrigin& origin);

}  // namespace relidar::cli
