// SPDX-License-Identifier: Apache-2.0
// Steps of a training that the commands `train` and `demo` share. They show a progress
// line, write a log file and stop after Ctrl-C.
#pragma once

#include <filesystem>
#include <string>

#include <relidar/run/run.hpp>
#include <relidar/train/train.hpp>

namespace relidar::cli {

/// Prepares a log for training with prepare_log() and shows the progress.
/// @throws Error with exit code 130 after Ctrl-C
void prepare_log_with_progress(Sequence& sequence, const Split& split, const Config& config, bool quiet,
                               const ProcessGroup& group = {}, StageTimes* stages = nullptr);

/// Trains a scene with a progress line on stderr. For each progress report, one JSON line
/// is written to log.jsonl. If the training is resumed, the lines up to its checkpoint
/// are kept. After Ctrl-C, training stops at the end of the current iteration. If the
/// file cannot be written, a note is printed and training continues.
/// @param session this function sets its members `stop` and `note`
TrainResult train_logged(Device& device, const Sequence& sequence, const Split& split, const Config& config,
                         const std::filesystem::path& folder, bool quiet, TrainSession session = {});

/// Runs the steps between the training of a scene and the training of its ray-drop
/// network. These steps place the held-out scans and measure the noise of intensities.
/// Then the run is saved again.
/// @param stages receives the times of "place", "scatter" and "save"
/// @return false if interrupted. The folder then holds the scene without these results.
bool complete_scene_with_progress(Device& device, Run& run, bool quiet, StageTimes& stages);

/// Trains the ray-drop network of a run and shows a progress line. The sequence of the
/// run must contain its scans.
/// @param session this function sets its members `progress`, `step`, `stop` and `note`
/// @return false if the user interrupted the training
bool refine_with_progress(Device& device, Run& run, bool quiet, RefineSession session = {});

/// Returns the text of the progress line, such as "iteration 1200/30000  4.20 it/s  eta
/// 1:54:00  loss 0.0123 (depth 0.01 intensity 0.002 drop 0.0003)".
std::string progress_text(const TrainProgress& progress);

/// Returns the time of each stage as a text, such as "read 3.1 s, register 10.2 s, ...".
/// Leaves out stages that took less than 0.1 s.
std::string stages_text(const StageTimes& times);
/// Appends the times of the stages to the file log.jsonl of the run.
void log_stages(const std::filesystem::path& folder, const StageTimes& times);

/// Write and read the file log.jsonl of a run. Reading skips invalid lines, because a
/// killed process may leave an incomplete last line.
void write_log(const std::filesystem::path& folder, const std::vector<TrainProgress>& lines);
std::vector<TrainProgress> read_log(const std::filesystem::path& folder);

/// Returns the number of the last iteration in log.jsonl. Returns 0 if the file has no
/// iteration.
int last_logged_iteration(const std::filesystem::path& folder);

}  // namespace relidar::cli
