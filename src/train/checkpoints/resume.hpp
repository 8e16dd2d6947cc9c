// SPDX-License-Identifier: Apache-2.0
// What of a training goes into a checkpoint beside the state of its loop, and comes out
// of it again. Private to train.
#pragma once

#include <map>
#include <string>
#include <vector>

#include <relidar/run/checkpoint.hpp>
#include <relidar/train/train.hpp>

#include "train/iteration_reports.hpp"

namespace relidar {

/// Settings and fingerprint of the log: what must be the same where training continues.
std::map<std::string, std::string> training_texts(const Sequence& sequence, const Split& split,
                                                  const Config& config);

/// Puts what the result knows so far: log and times. @param train_s since training
/// started
void write_result(StateWriter& write, const TrainResult& result, double train_s);
/// Takes it out again.
void read_result(const Checkpoint& checkpoint, const Config& config, TrainResult& result);

/// The scene at a checkpoint. @throws DataError where its arrays or its layout are not
/// sound
Scene scene_of(const Checkpoint& checkpoint);

/// Adds a line to the log. The rest takes as long as the pace since the first line says:
/// before it drivers compile kernels. Infinite in the first one. @param seconds  since
/// training started
void add_line(std::vector<TrainProgress>& log, const LogLine& line, const Config& config, double seconds);

}  // namespace relidar
