// SPDX-License-Identifier: Apache-2.0
// Formats evaluations (<relidar/score/evaluation.hpp>) for the terminal and for files.
#pragma once

#include <string>

#include <nlohmann/json_fwd.hpp>

#include <relidar/score/evaluation.hpp>

namespace relidar::cli {

class Progress;
class Ranks;

/// Returns a callback that shows the progress of an evaluation. After Ctrl-C the callback
/// throws an Error with exit code 130.
relidar::Progress shown_until_interrupted(Progress& progress);

/// Returns the five most important scores for the terminal, one per line. Skips scores
/// that are missing in the evaluation.
std::string score_summary(const Evaluation& evaluation);
/// Returns the tables of all metrics for the terminal: mean, lowest and highest value
/// over the frames, the mean of the baseline if there is one, errors by region, and the
/// meaning of the names.
std::string metric_table(const Evaluation& evaluation, const Evaluation* baseline = nullptr);

/// Combines the frames that several processes have scored.
/// @return in the first process: the evaluation of all frames, where frames of other
/// processes have no images; in the others: `mine`
Evaluation joined(const Evaluation& mine, const Ranks& ranks);

/// Returns each scored frame as an object with its number, LiDAR, time, number of rays,
/// tracing time and metrics. Used for metrics.json and for messages between processes.
nlohmann::ordered_json frames_json(const Evaluation& evaluation);

/// Facts about an evaluation that metrics.json holds in addition to the scores.
struct MetricsOrigin {
    std::string run;  ///< Path of the run. Empty if a log was scored.
    std::string device;
    std::uint64_t peak_device_bytes = 0;
    double seconds = 0.0;
    const Evaluation* baseline = nullptr;
};
/// Returns metrics.json: scores of each frame and their mean, with protocol, timings,
/// device and memory.
std::string metrics_json(const Evaluation& evaluation, const Config& config, const MetricsOrigin& origin);

}  // namespace relidar::cli
