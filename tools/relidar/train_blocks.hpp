// SPDX-License-Identifier: Apache-2.0
// Training of a long log, block by block.
#pragma once

#include <string>

#include <relidar/run.hpp>
#include <relidar/train.hpp>

namespace relidar::cli {

/// How blocks are trained.
struct BlockTraining {
    bool quiet = false;
    std::string resume;   ///< the command that goes on, for messages
};

/// Trains the blocks of a prepared log that have not been trained before, each into RUN/blocks/NNN, a run of its own, and joins them:
/// scene and poses of the run. @return of all blocks: the mean of their logs, sums of times, the largest peak
/// @throws Error with exit code 130 after Ctrl-C; DataError for a block that was trained with other settings or frames
TrainResult train_blocks(Device& device, Run& run, const BlockTraining& how);

}  // namespace relidar::cli
