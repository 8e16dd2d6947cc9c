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

/// Returns a callback that shows the progress of an evaluation. After Ctrl-C, the
/// callback throws an Error with exit code 130 to stop the evaluation.
relidar::Progress stop_on_interrupt(Progress& progress);

/// Returns the five most important scores for the terminal, one per line. A missing score
/// is left out.
std::string format_score_summary(const Evaluation& evaluation);
/// Returns a table of the 20 moving boxes with the worst scores. The first row contains
/// the column titles.
std::vector<std::vector<std::string>> make_actor_rows(const Evaluation& evaluation);
/// Returns tables of all metrics for the terminal. They show the mean, minimum and
/// maximum over the frames, the errors by region, and the meaning of each metric.
/// @param baseline scores of a baseline, whose means are shown too; may be null
std::string format_metric_table(const Evaluation& evaluation, const Evaluation* baseline = nullptr);

/// Collects the scores of all MPI processes in the first process.
/// @return in the first process, the scores of all frames, without the images of other
/// processes; in the other processes, `local`
Evaluation gather_evaluation(const Evaluation& local, const Ranks& ranks);

/// Returns the scored frames as JSON objects. Each object contains the frame number,
/// LiDAR, time, number of rays, render time, metrics, and the scores of each moving box.
/// The program writes them into metrics.json and sends them between MPI processes.
nlohmann::ordered_json make_frames_json(const Evaluation& evaluation);

/// Describes how the scores were computed: device, memory, time and baseline. These
/// values are also written to metrics.json.
struct MetricsOrigin {
    std::string run;  ///< Path of the run. Empty if a baseline was scored without a run.
    std::string device;
    std::uint64_t peak_device_bytes = 0;
    double seconds = 0.0;
    const Evaluation* baseline = nullptr;
};
/// Returns the text of the file metrics.json. It contains the scores of each frame, their
/// means, the evaluation protocol, timings, device and memory.
std::string make_metrics_json(const Evaluation& evaluation, const Config& config,
                              const MetricsOrigin& origin);

}  // namespace relidar::cli
