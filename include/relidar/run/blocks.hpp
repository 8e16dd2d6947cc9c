// SPDX-License-Identifier: Apache-2.0
// A long log in blocks: stretches of the trajectory of its sensor, each trained on its
// own with the sweeps that see it, and joined to one scene whose background is read block
// by block (Scene::blocks). The paper trains a log in one piece, and names that as its
// limit.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <relidar/log/sequence.hpp>
#include <relidar/run/config.hpp>
#include <relidar/run/run.hpp>
#include <relidar/scene/scene.hpp>

namespace relidar {

/// A stretch of the trajectory.
struct Block {
    double begin_m = 0.0, end_m = 0.0;  ///< driven since the log began
    /// positions in Sequence::frames of the sweeps that were taken on it, held-out ones
    /// too
    std::vector<int> own;
    /// of the training frames that see it: its own, and those within the halo wherever
    /// they come from
    std::vector<int> train;
};

/// Cuts the trajectory of a log's vehicle into blocks of equal length, options.length_m
/// at most. A stretch without a sweep, where the log has a gap, is no block. @throws
/// DataError where a block has no training frame within its halo
std::vector<Block> plan_blocks(const Sequence& sequence, const Split& split, const BlockConfig& options);

/// The part of a log that a block is trained on: its training frames, its own held-out
/// ones, and boxes that come near them.
struct BlockLog {
    Sequence sequence;
    Split split;
    Config config;  ///< of the block's own training: in one piece, its settings named for boxes that it has
};
/// Copies it out of a prepared log. @param config  of the whole training
BlockLog block_log(const Sequence& sequence, const Split& split, const Block& block, const Config& config);

/// Leaves only those surfels in the background that belong to a block: a place belongs to
/// the block of the nearest sweep.
void keep_own_surfels(Scene& scene, const Sequence& sequence, const std::vector<Block>& blocks,
                      std::size_t block);

/// Joins trained blocks to one run: backgrounds stay in their files, each actor comes
/// from the block whose training frames saw it most often, poses that training has
/// corrected from the block on which a sweep was taken.
/// @param run      of the prepared log, without a scene
/// @param folders  [blocks] runs of the blocks (save_run()) @throws DataError as
/// load_run()
void join_blocks(Run& run, const std::vector<Block>& blocks,
                 const std::vector<std::filesystem::path>& folders);

}  // namespace relidar
