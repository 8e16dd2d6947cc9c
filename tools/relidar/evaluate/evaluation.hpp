// SPDX-License-Identifier: Apache-2.0
// Evaluations (<relidar/score/evaluation.hpp>) for people and for files.
#pragma once

#include <string>

#include <nlohmann/json_fwd.hpp>

#include <relidar/score/evaluation.hpp>

namespace relidar::cli {

class Progress;
class Ranks;

/// How an evaluation shows how far it is, and notices Ctrl-C: it then ends with an Error
/// of exit code 130.
relidar::Progress shown_until_interrupted(Progress& progress);

/// Returns the five most important scores for the terminal, one per line. Skips scores that
/// the evaluation does not have.
std::string score_summary(const Evaluation& evaluation);
/// Returns the tables of all metrics for the terminal: mean, lowest and highest of the frames, the mean of
/// the baseline where there is one, errors by region, and what the names mean.
std::string metric_table(const Evaluation& evaluation, const Evaluation* baseline = nullptr);

/// The evaluation of all frames, where each process has scored its share of them: on the
/// first one; elsewhere what was given. Frames of other processes come without their
/// images.
Evaluation joined(const Evaluation& mine, const Ranks& ranks);

/// Each scored frame as an object: its number, LiDAR, time, rays, tracing time and
/// metrics. In metrics.json, and from process to process.
nlohmann::ordered_json frames_json(const Evaluation& evaluation);

/// What a metrics.json needs beside the numbers.
struct MetricsOrigin {
    std::string run;  ///< path of the run; empty without one
    std::string device;
    std::uint64_t peak_device_bytes = 0;
    double seconds = 0.0;
    const Evaluation* baseline = nullptr;
};
/// Per frame and mean, with protocol, timings, device and memory.
std::string metrics_json(const Evaluation& evaluation, const Config& config, const MetricsOrigin& origin);

}  // namespace relidar::cli
