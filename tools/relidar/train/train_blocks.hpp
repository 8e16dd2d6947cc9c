// SPDX-License-Identifier: Apache-2.0
// Divides the training of a long log into blocks.
#pragma once

#include <string>

#include <relidar/run/run.hpp>
#include <relidar/train/train.hpp>

#include "ranks.hpp"

namespace relidar::cli {

/// Options for training in blocks.
struct BlockTraining {
    /// Processes that share the training. A process that is free trains the next block.
    const Ranks& ranks;
    bool quiet = false;
    std::string resume;  ///< Command that resumes the training. Error messages contain it.
};

/// Trains all blocks of a log that are not yet trained. Each block is saved as a run in
/// RUN/blocks/NNN. When all blocks are trained, the first process joins their surfels and
/// poses into one run.
/// @return over all blocks: the mean of the training logs, the sum of the times, and the
/// largest memory peak
/// @throws Error with exit code 130 after Ctrl-C; DataError if a block was trained with
/// other settings or frames
TrainResult train_blocks(Device& device, Run& run, const BlockTraining& how);

/// Checks that the trained blocks of a run fit the current settings, so that blocks
/// trained now can be joined with them.
/// @throws DataError that names the first block that does not fit
void check_trained_blocks(const std::filesystem::path& run, const Config& config);

}  // namespace relidar::cli
