// SPDX-License-Identifier: Apache-2.0
// Trains a long log in blocks. A block is a section of the sensor's trajectory. It is
// trained separately, with the sweeps that were recorded in or near this section. The
// trained blocks are then joined to one scene. The backgrounds of the blocks stay in
// files and are loaded when needed (Scene::blocks). The paper trains a log as one unit
// and names this as a limitation.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <relidar/log/sequence.hpp>
#include <relidar/run/config.hpp>
#include <relidar/run/run.hpp>
#include <relidar/scene/scene.hpp>

namespace relidar {

/// Section of the sensor's trajectory that is trained separately.
struct TrajectoryBlock {
    /// Begin and end of the section, measured along the trajectory from the start of the
    /// log, metres.
    double begin_m = 0.0, end_m = 0.0;
    /// Indices in LidarSequence::frames of the sweeps recorded in this section, including
    /// held-out sweeps.
    std::vector<int> recorded_frames;
    /// Indices of the training frames that train this section: the sweeps recorded in the
    /// section or near it, within the distance BlockConfig::halo_m.
    std::vector<int> train;
};

/// Divides the vehicle's trajectory into blocks of equal length, at most
/// options.length_m. Leaves out blocks without a recorded sweep, where the log has a gap.
/// @throws DataError if a block has no training frame within options.halo_m metres
std::vector<TrajectoryBlock> plan_training_blocks(const LidarSequence& sequence, const TrainTestSplit& split,
                                                  const BlockConfig& options);

/// Part of a log that is used to train one block. It contains the training frames of the
/// block, the held-out frames recorded in the block, and the boxes near these frames.
struct BlockTrainingLog {
    LidarSequence sequence;
    TrainTestSplit split;
    /// Settings for training this block. They do not divide the log into blocks again,
    /// and they list only the actor tracks of this block.
    Config config;
};
/// Copies the frames and boxes that are needed to train one block from a log.
/// @param config settings of the complete training
BlockTrainingLog copy_frames_and_boxes_of_block(const LidarSequence& sequence, const TrainTestSplit& split,
                                                const TrajectoryBlock& block, const Config& config);

/// Removes all background surfels that belong to other blocks. A surfel belongs to the
/// block that contains the sweep nearest to the surfel.
void remove_surfels_of_other_blocks(Scene& scene, const LidarSequence& sequence,
                                    const std::vector<TrajectoryBlock>& blocks, std::size_t block_index);

/// Joins trained blocks to one run. Background surfels stay in the files of the blocks.
/// Each actor is copied from the block in which the most training frames saw this actor.
/// The corrected pose of each sweep is copied from the block in which the sweep was
/// recorded.
/// @param run run with the prepared log and without a scene
/// @param run_folders [blocks] run folders of the blocks
/// @throws DataError if a run folder has a missing, truncated or inconsistent file
void join_trained_blocks(TrainedRun& run, const std::vector<TrajectoryBlock>& blocks,
                         const std::vector<std::filesystem::path>& run_folders);

}  // namespace relidar
