// SPDX-License-Identifier: Apache-2.0
// Coverage of a log: the space that the rays of its training scans have crossed or in
// which they have hit something. A simulated ray may hit a surface outside this space.
// Such a surface is extrapolated, because no training scan observed it.
#pragma once

#include <array>
#include <cstdint>
#include <unordered_map>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/log/log.hpp>

namespace relidar {

/// A set of cubic cells in relidar's world frame, stored in blocks of 8 x 8 x 8 cells.
class ObservedVoxelSet {
public:
    static constexpr double kCell_m = 1.0;
    static constexpr int kBlockCells = 8;  ///< cells along an edge of a block
    static constexpr std::size_t kBlockWords = 32;
    /// Bits of the cells of a block, 16 in each word. Cell (x, y, z) of the block is bit
    /// x + 8 y + 64 z.
    using VoxelBits = std::array<std::uint16_t, kBlockWords>;
    struct VoxelBlock {
        glm::ivec3 grid_index{0};  ///< position of the lowest corner, in units of blocks
        VoxelBits cells{};
    };

    bool empty() const { return blocks_.empty(); }
    /// Adds every cell that a line segment crosses. Adds no cell if a coordinate is not
    /// finite.
    /// @param start_m [3] start of the segment; metres, world frame
    /// @param end_m [3] end of the segment; metres, world frame
    void add_segment(const glm::dvec3& start_m, const glm::dvec3& end_m);
    void add_block(const VoxelBlock& block);
    void merge(const ObservedVoxelSet& other_set);
    /// Returns the fraction of a line segment's length that is in cells of the set, 0..1.
    /// @param start_m [3] start of the segment; metres, world frame
    /// @param end_m [3] end of the segment; metres, world frame
    /// @return 0 if a coordinate is not finite
    double observed_fraction(const glm::dvec3& start_m, const glm::dvec3& end_m) const;
    /// Returns all blocks, sorted by their positions in ascending order.
    std::vector<VoxelBlock> list_blocks() const;

private:
    std::unordered_map<std::uint64_t, VoxelBlock> blocks_;  ///< blocks by position
};

/// Returns the space that the rays of some scans have observed. A ray with a return has
/// observed the space up to its point. For a dropped ray, the result depends on the other
/// rays of the same firing:
/// - If there are returns above and below the ray, it has observed the space up to the
///   nearer of these two returns.
/// - If the ray is above all returns, it has observed the space up to `max_range_m`.
/// - Otherwise the ray has observed nothing.
///
/// Two adjacent beams of a firing also observe the space between them, up to the shorter
/// of their two lengths.
/// @param world_from_vehicle  poses of the vehicle at the times of the frames
/// @param frames  indices into Log::frames of the frames to use
/// @param max_range_m  maximum observed length of a ray
ObservedVoxelSet observe_coverage(const Log& log, const PoseTrack& world_from_vehicle,
                                  const std::vector<int>& frames, double max_range_m);

}  // namespace relidar
