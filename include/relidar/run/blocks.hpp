// SPDX-License-Identifier: Apache-2.0
// Trains a long log in blocks: sections of the sensor's trajectory, each with the sweeps
// that were recorded in or near it. The trained blocks are then joined to one scene,
// whose background stays in files that are loaded when needed (Scene::blocks). The paper
// trains a log as one unit and names this as a limitation.
#pragma once

#include <filesystem>
#include <vector>

#include <relidar/log/log.hpp>
#include <relidar/run/config.hpp>
#include <relidar/run/run.hpp>
#include <relidar/scene/scene.hpp>

namespace relidar {

struct TrajectoryBlock {
    /// Distances along the trajectory from the start of the log, metres.
    double begin_m = 0.0, end_m = 0.0;
    /// Indices in Log::frames, including held-out sweeps.
    std::vector<int> recorded_frames;
    /// Training frames in the section, or within BlockConfig::halo_m of it.
    std::vector<int> train;
};

/// Divides the vehicle's trajectory into blocks of equal length, at most
/// options.length_m. Leaves out blocks without a recorded sweep, where the log has a gap.
/// @throws DataError if a block has no training frame within options.halo_m metres
std::vector<TrajectoryBlock> plan_blocks(const Log& log, const Split& split, const BlockConfig& options);

/// Training frames of a block, held-out frames recorded in it, and boxes near these
/// frames.
struct BlockTrainingLog {
    Log log;
    Split split;
    /// They do not divide the log again, and list only the actor tracks of this block.
    Config config;
};
/// Returns the part of a log that a block is trained with.
/// @param config settings of the complete training
BlockTrainingLog cut_log(const Log& log, const Split& split, const TrajectoryBlock& block,
                         const Config& config);

/// Removes the background surfels of other blocks. A surfel belongs to the block that
/// contains the nearest sweep.
void keep_block_surfels(Scene& scene, const Log& log, const std::vector<TrajectoryBlock>& blocks,
                        std::size_t index);

/// Joins trained blocks to one run. Background surfels stay in the files of the blocks.
/// Each actor comes from the block in which the most training frames saw it, each
/// corrected pose from the block that recorded the sweep.
/// @param run run with the prepared log and without a scene
/// @param folders [blocks] run folders of the blocks
/// @throws DataError if a run folder has a missing, truncated or inconsistent file
void join_blocks(Run& run, const std::vector<TrajectoryBlock>& blocks,
                 const std::vector<std::filesystem::path>& folders);

}  // namespace relidar
