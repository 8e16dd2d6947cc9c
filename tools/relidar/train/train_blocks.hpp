// SPDX-License-Identifier: Apache-2.0
// Training of a long log, block by block.
#pragma once

#include <string>

#include <relidar/run/run.hpp>
#include <relidar/train/train.hpp>

#include "ranks.hpp"

namespace relidar::cli {

/// How blocks are trained.
struct BlockTraining {
    const Ranks& ranks;  ///< each block is trained by whoever comes to it first
    bool quiet = false;
    std::string resume;  ///< the command that goes on, for messages
};

/// Trains the blocks of a prepared log that have not been trained before, each into
/// RUN/blocks/NNN, a run of its own; the first rank joins them once all are trained:
/// scene and poses of the run. @return of all blocks: the mean of their logs, sums of
/// times, the largest peak
/// @throws Error with exit code 130 after Ctrl-C; DataError for a block that was trained
/// with other settings or frames
TrainResult train_blocks(Device& device, Run& run, const BlockTraining& how);

/// Whether the blocks that a run has can be joined with others trained by these settings.
/// @throws DataError for one that cannot
void check_trained_blocks(const std::filesystem::path& run, const Config& config);

}  // namespace relidar::cli
