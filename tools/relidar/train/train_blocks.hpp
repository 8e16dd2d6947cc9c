// SPDX-License-Identifier: Apache-2.0
// Trains a long log block by block.
#pragma once

#include <string>

#include <relidar/run/run.hpp>
#include <relidar/train/train.hpp>

#include "ranks.hpp"

namespace relidar::cli {

/// Options for training in blocks.
struct BlockTraining {
    const Ranks& ranks;  ///< Processes that share the work. The first free process trains the next block.
    bool quiet = false;
    std::string resume;  ///< Command that resumes the training, for messages.
};

/// Trains all untrained blocks of a prepared log. Each block becomes a run in
/// RUN/blocks/NNN. When all blocks are trained, the first rank joins their scenes and
/// poses into the run.
/// @return over all blocks: the mean of their logs, the sums of their times, and the
/// largest memory peak
/// @throws Error with exit code 130 after Ctrl-C; DataError if a block was trained with
/// other settings or frames
TrainResult train_blocks(Device& device, Run& run, const BlockTraining& how);

/// Checks that the existing blocks of a run can be joined with blocks trained with these
/// settings.
/// @throws DataError for the first block that cannot
void check_trained_blocks(const std::filesystem::path& run, const Config& config);

}  // namespace relidar::cli
