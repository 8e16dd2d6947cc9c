// SPDX-License-Identifier: Apache-2.0
// Reads and writes the parts of a checkpoint outside the state of the training loop:
// settings, log lines, times. Private to train.
#pragma once

#include <map>
#include <string>
#include <vector>

#include <relidar/run/checkpoint.hpp>
#include <relidar/train/train.hpp>

#include "train/iteration_reports.hpp"

namespace relidar {

/// Returns the settings and the hashes of the log that must be the same when training is
/// resumed.
std::map<std::string, std::string> list_settings_and_hashes_for_resume(const LidarSequence& sequence,
                                                                       const TrainTestSplit& split,
                                                                       const Config& config);

/// Writes to a checkpoint: the training log, the time that the initialisation took
/// (`result.initialise_s`), and the training time.
/// @param training_time_s  seconds since training started
void write_training_log_and_times(CheckpointWriter& writer, const TrainResult& result,
                                  double training_time_s);
/// Reads the values of write_training_log_and_times() from a checkpoint into `result`.
void read_training_log_and_times(const Checkpoint& checkpoint, const Config& config, TrainResult& result);

/// Returns the scene in a checkpoint.
/// @throws DataError if its arrays or its layout are invalid
Scene read_checkpoint_scene(const Checkpoint& checkpoint);

/// Adds a line to the training log. Estimates the remaining time from the speed after the
/// first line. Earlier iterations are slower, because drivers still compile kernels. In
/// the first line, the remaining time is infinite.
/// @param elapsed_s  seconds since training started
void append_training_log_line(std::vector<TrainProgress>& log, const TrainLogLine& line, const Config& config,
                              double elapsed_s);

}  // namespace relidar
