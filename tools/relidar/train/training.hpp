// SPDX-License-Identifier: Apache-2.0
// Steps that `train` and `demo` share. Each shows a progress line and stops after Ctrl-C.
#pragma once

#include <filesystem>
#include <string>

#include <relidar/run/run.hpp>
#include <relidar/train/train.hpp>

namespace relidar::cli {

/// Prepares a log for training, for example its poses, and prints what was done.
/// @throws Error with exit code 130 after Ctrl-C
void prepare_log(Log& log, const Split& split, const Config& config, bool quiet,
                 const ProcessGroup& process_group = {}, StageTimes* stage_times = nullptr);

/// Trains a scene. Each progress report is also a JSON line in log.jsonl, after the lines
/// before the checkpoint.
/// @param session this function sets its members `stop` and `note`
TrainResult train_scene(Device& device, const Log& log, const Split& split, const Config& config,
                        const std::filesystem::path& folder, bool quiet, TrainSession session = {});

/// Runs the steps between the training of a scene and of its ray-drop network: aligns the
/// held-out scans to the scene, learns the noise of intensities, and saves the run.
/// @param stage_times receives the times of "place", "scatter" and "save"
/// @return `stopped` if the user interrupted; the results are then not saved
TrainingEndReason align_and_fit_noise(Device& device, Run& run, bool quiet, StageTimes& stage_times);

/// Trains the ray-drop network of a run. The scans of the log must be loaded.
/// @param session this function sets its members `progress`, `step`, `stop` and `note`
/// @return `stopped` if the user interrupted the training
TrainingEndReason train_network_with_bar(Device& device, Run& run, bool quiet,
                                         RayDropTrainingSession session = {});

/// The state of a training as one line: iterations, speed, remaining time and losses.
std::string progress_line(const TrainProgress& progress);

/// For example "read 3.1 s, register 10.2 s". Leaves out stages of less than 0.1 s.
std::string stage_times_text(const StageTimes& stage_times);
void append_stage_times(const std::filesystem::path& folder, const StageTimes& stage_times);

/// Writes log.jsonl of a run, one JSON object per line of the log.
void write_log(const std::filesystem::path& folder, const std::vector<TrainProgress>& entries);
/// Reads log.jsonl of a run. Skips invalid lines, because a killed process may leave an
/// incomplete last line.
std::vector<TrainProgress> read_log(const std::filesystem::path& folder);

/// 0 if log.jsonl contains no iteration
int last_iteration(const std::filesystem::path& folder);

}  // namespace relidar::cli
