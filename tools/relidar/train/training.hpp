// SPDX-License-Identifier: Apache-2.0
// Training as the commands `train` and `demo` do it: with a progress line, a log, and
// Ctrl-C.
#pragma once

#include <filesystem>
#include <string>

#include <relidar/run/run.hpp>
#include <relidar/train/train.hpp>

namespace relidar::cli {

/// prepare_log(), telling what it estimates. @throws Error with exit code 130 after
/// Ctrl-C
void prepare_log_shown(Sequence& sequence, const Split& split, const Config& config, bool quiet,
                       const ProcessGroup& group = {}, StageTimes* stages = nullptr);

/// Trains with a progress line on stderr and one JSON line of log.jsonl for each; the log
/// of a run that continues starts with the lines up to its checkpoint. Ctrl-C stops after
/// the current iteration. A log that cannot be written costs a note, not the training.
/// @param session its stop and note are filled in here
TrainResult train_logged(Device& device, const Sequence& sequence, const Split& split, const Config& config,
                         const std::filesystem::path& folder, bool quiet, TrainSession session = {});

/// What a trained scene that is saved gets before its network: place_held_out() and
/// learn_scatter(), with progress lines, telling how far scans moved. Saves the run once
/// it has both. @return whether it was not interrupted: the folder then has the scene
/// without either
/// @param stages  "place", "scatter", "save"
bool complete_scene_shown(Device& device, Run& run, bool quiet, StageTimes& stages);

/// Trains the ray-drop network of a run whose sequence has its scans, with a progress
/// line. @return whether it was not interrupted
/// @param session  its progress, step, stop and note are filled in here
bool refine_shown(Device& device, Run& run, bool quiet, RefineSession session = {});

/// "iteration 1200/30000  4.20 it/s  eta 1:54:00  loss 0.0123 (depth 0.01 intensity 0.002
/// drop 0.0003)"
std::string progress_text(const TrainProgress& progress);

/// "read 3.1 s, register 10.2 s, ...": what a command has spent its time on, stages of
/// less than a tenth of a second left out.
std::string stages_text(const StageTimes& times);
/// Adds them to log.jsonl of a run, as its last line.
void log_stages(const std::filesystem::path& folder, const StageTimes& times);

/// Writes and reads log.jsonl of a run. Lines that are none, as the last one of a killed
/// process may be, are left out.
void write_log(const std::filesystem::path& folder, const std::vector<TrainProgress>& lines);
std::vector<TrainProgress> read_log(const std::filesystem::path& folder);

/// The last iteration in the log of a run; 0 where there is none.
int last_logged_iteration(const std::filesystem::path& folder);

}  // namespace relidar::cli
