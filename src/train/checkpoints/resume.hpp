// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include <relidar/run/checkpoint.hpp>
#include <relidar/train/train.hpp>

#include "train/iteration_reports.hpp"

namespace relidar {

/// The training log, the time of the initialisation and the training time.
/// @param training_time_s  seconds since training started
void write_log(CheckpointWriter& writer, const TrainResult& result, double training_time_s);
void read_log(const Checkpoint& checkpoint, const Config& config, TrainResult& result);

/// @throws DataError if its arrays or its layout are invalid
Scene read_scene(const Checkpoint& checkpoint);

/// Estimates the remaining time from the speed after the first line, because drivers
/// still compile kernels before. In the first line it is infinite.
/// @param elapsed_s  seconds since training started
void append_log_line(std::vector<TrainProgress>& log, const TrainLogLine& line, const Config& config,
                     double elapsed_s);

}  // namespace relidar
