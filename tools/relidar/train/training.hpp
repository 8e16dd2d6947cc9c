// SPDX-License-Identifier: Apache-2.0
// Training steps shared by the commands `train` and `demo`, with a progress line, a log
// file and handling of Ctrl-C.
#pragma once

#include <filesystem>
#include <string>

#include <relidar/run/run.hpp>
#include <relidar/train/train.hpp>

namespace relidar::cli {

/// Calls prepare_log() and shows its progress.
/// @throws Error with exit code 130 after Ctrl-C
void prepare_log_shown(Sequence& sequence, const Split& split, const Config& config, bool quiet,
                       const ProcessGroup& group = {}, StageTimes* stages = nullptr);

/// Trains with a progress line on stderr and writes one JSON line to log.jsonl for each
/// progress report. A resumed run keeps the log lines up to its checkpoint. Ctrl-C stops
/// after the current iteration. If the log cannot be written, a note is printed and
/// training continues.
/// @param session this function sets its members `stop` and `note`
TrainResult train_logged(Device& device, const Sequence& sequence, const Split& split, const Config& config,
                         const std::filesystem::path& folder, bool quiet, TrainSession session = {});

/// Completes a trained scene that is already saved, before its network is trained. Calls
/// place_held_out() and learn_scatter() with progress lines, and then saves the run
/// again.
/// @param stages receives the times of "place", "scatter" and "save"
/// @return false if interrupted; the folder then holds the scene without these results
bool complete_scene_shown(Device& device, Run& run, bool quiet, StageTimes& stages);

/// Trains the ray-drop network of a run with a progress line. The run's sequence must
/// hold the scans.
/// @param session this function sets its members `progress`, `step`, `stop` and `note`
/// @return false if interrupted
bool refine_shown(Device& device, Run& run, bool quiet, RefineSession session = {});

/// Returns a line such as "iteration 1200/30000  4.20 it/s  eta 1:54:00  loss 0.0123
/// (depth 0.01 intensity 0.002 drop 0.0003)".
std::string progress_text(const TrainProgress& progress);

/// Returns the time of each stage, such as "read 3.1 s, register 10.2 s, ...". Stages
/// shorter than a tenth of a second are left out.
std::string stages_text(const StageTimes& times);
/// Appends the times of the stages to the run's log.jsonl.
void log_stages(const std::filesystem::path& folder, const StageTimes& times);

/// Write and read log.jsonl of a run. Invalid lines are skipped, because a killed process
/// may leave an incomplete last line.
void write_log(const std::filesystem::path& folder, const std::vector<TrainProgress>& lines);
std::vector<TrainProgress> read_log(const std::filesystem::path& folder);

/// Returns the last iteration in the log of a run, or 0 if there is none.
int last_logged_iteration(const std::filesystem::path& folder);

}  // namespace relidar::cli
