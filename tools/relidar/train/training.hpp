// SPDX-License-Identifier: Apache-2.0
// Steps that `train` and `demo` share. Each shows a progress line and stops after Ctrl-C.
#pragma once

#include <filesystem>
#include <string>

#include <relidar/run/run.hpp>
#include <relidar/train/train.hpp>

namespace relidar::cli {

/// @throws Error with exit code 130 after Ctrl-C
void prepare_log_for_training_with_progress(LidarSequence& sequence, const TrainTestSplit& split,
                                            const Config& config, bool quiet,
                                            const ProcessGroup& process_group = {},
                                            StageTimes* stage_times = nullptr);

/// Each progress report is also a JSON line in log.jsonl, after the lines before the
/// checkpoint.
/// @param session this function sets its members `stop` and `note`
TrainResult train_scene_with_progress(Device& device, const LidarSequence& sequence,
                                      const TrainTestSplit& split, const Config& config,
                                      const std::filesystem::path& run_folder, bool quiet,
                                      TrainSession session = {});

/// Saves the run.
/// @param stage_times receives the times of "place", "scatter" and "save"
/// @return `stopped` if the user interrupted; the results are then not saved
TrainingEndReason align_held_out_scans_and_fit_intensity_noise(Device& device, TrainedRun& run, bool quiet,
                                                               StageTimes& stage_times);

/// The scans of the log must be loaded.
/// @param session this function sets its members `progress`, `step`, `stop` and `note`
/// @return `stopped` if the user interrupted the training
TrainingEndReason train_drop_network_with_progress(Device& device, TrainedRun& run, bool quiet,
                                                   RayDropTrainingSession session = {});

std::string format_progress_line(const TrainProgress& progress);

/// For example "read 3.1 s, register 10.2 s". Leaves out stages of less than 0.1 s.
std::string format_stage_times(const StageTimes& stage_times);
void append_stage_times_to_log(const std::filesystem::path& run_folder, const StageTimes& stage_times);

/// log.jsonl of a run. Reading skips invalid lines, because a killed process may leave an
/// incomplete last line.
void write_training_log_file(const std::filesystem::path& run_folder,
                             const std::vector<TrainProgress>& log_entries);
std::vector<TrainProgress> read_training_log_file(const std::filesystem::path& run_folder);

/// 0 if log.jsonl contains no iteration
int read_last_logged_iteration(const std::filesystem::path& run_folder);

}  // namespace relidar::cli
