// SPDX-License-Identifier: Apache-2.0
// Training of a long log in blocks. A block is a section of the sensor's trajectory,
// trained separately with the sweeps that see it. The blocks are then joined to one
// scene, whose background is loaded block by block (Scene::blocks). The paper trains a
// log as one unit and names this as a limitation.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <relidar/log/sequence.hpp>
#include <relidar/run/config.hpp>
#include <relidar/run/run.hpp>
#include <relidar/scene/scene.hpp>

namespace relidar {

/// Section of the sensor's trajectory.
struct Block {
    /// Begin and end of the section, in metres driven since the start of the log.
    double begin_m = 0.0, end_m = 0.0;
    /// Indices in Sequence::frames of the sweeps recorded in this section, including
    /// held-out sweeps.
    std::vector<int> own;
    /// Indices of the training frames that see the section: sweeps recorded in it, and
    /// all sweeps recorded within the halo.
    std::vector<int> train;
};

/// Divides the trajectory of a log's vehicle into blocks of equal length, at most
/// options.length_m. Omits sections without a sweep, where the log has a gap.
/// @throws DataError if a block has no training frame within its halo
std::vector<Block> plan_blocks(const Sequence& sequence, const Split& split, const BlockConfig& options);

/// Part of a log for the training of a block: its training frames, the held-out frames
/// recorded in the block, and boxes near them.
struct BlockLog {
    Sequence sequence;
    Split split;
    /// Settings for the training of the block, without further division into blocks. They
    /// list only tracks that the block has.
    Config config;
};
/// Extracts the part of a prepared log that a block needs.
/// @param config settings of the complete training
BlockLog block_log(const Sequence& sequence, const Split& split, const Block& block, const Config& config);

/// Removes all background surfels that do not belong to a block. A surfel belongs to the
/// block whose sweep is nearest to it.
void keep_own_surfels(Scene& scene, const Sequence& sequence, const std::vector<Block>& blocks,
                      std::size_t block);

/// Joins trained blocks to one run. Background surfels stay in the files of the blocks.
/// Each actor comes from the block whose training frames saw it most often. Corrected
/// poses come from the block in which the sweep was recorded.
/// @param run run with the prepared log and without a scene
/// @param folders [blocks] run folders of the blocks (save_run())
/// @throws DataError as load_run()
void join_blocks(Run& run, const std::vector<Block>& blocks,
                 const std::vector<std::filesystem::path>& folders);

}  // namespace relidar
