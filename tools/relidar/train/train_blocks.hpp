// SPDX-License-Identifier: Apache-2.0
// Divides a long log into blocks and trains one block after the other.
#pragma once

#include <string>

#include <relidar/run/run.hpp>
#include <relidar/train/train.hpp>

#include "ranks.hpp"

namespace relidar::cli {

struct BlockTrainingOptions {
    /// Each process trains the next free block when it has finished one.
    const MpiProcessGroup& ranks;
    bool quiet = false;
    std::string resume;  ///< Command line that resumes the training. Error messages contain it.
};

/// Saves each block as a run in RUN/blocks/NNN. When all blocks are trained, the first
/// MPI process joins them into one run.
/// @return over all blocks: the mean of the training logs, the sum of the times, and the
/// largest memory peak
/// @throws Error with exit code 130 after Ctrl-C
/// @throws DataError if a block was trained with other settings or frames
TrainResult train_blocks(Device& device, Run& run, const BlockTrainingOptions& block_options);

/// Checks that all trained blocks of a run have these settings.
/// @throws DataError that names the first block with other settings
void check_blocks(const std::filesystem::path& folder, const Config& config);

}  // namespace relidar::cli
