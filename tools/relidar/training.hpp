// SPDX-License-Identifier: Apache-2.0
// Training as the commands `train` and `demo` do it: with a progress line, a log, and Ctrl-C.
#pragma once

#include <filesystem>
#include <string>

#include <relidar/train.hpp>

namespace relidar::cli {

/// Trains with a progress line on stderr and one JSON line of log.jsonl for each; Ctrl-C stops at the next one.
TrainResult train_logged(Device& device, const Sequence& sequence, const Split& split, const Config& config, const std::filesystem::path& folder, bool quiet);

/// "iteration 1200/30000  4.20 it/s  eta 1:54:00  loss 0.0123 (depth 0.01 intensity 0.002 drop 0.0003)"
std::string progress_text(const TrainProgress& progress);

}  // namespace relidar::cli
