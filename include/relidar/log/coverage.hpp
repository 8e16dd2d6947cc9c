// SPDX-License-Identifier: Apache-2.0
// Where a log has looked: the space that rays of its training scans have passed, or met
// something in. What a simulated ray meets elsewhere is extrapolated.
#pragma once

#include <array>
#include <cstdint>
#include <unordered_map>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/log/sequence.hpp>

namespace relidar {

/// A set of cubic cells of relidar's world, in blocks of 8 x 8 x 8.
class Coverage {
public:
    static constexpr double kCell_m = 1.0;
    static constexpr int kBlockCells = 8;  ///< along an edge
    static constexpr std::size_t kWords = 32;
    /// Cell (x, y, z) of a block is bit x + 8 y + 64 z, 16 bits a word.
    using Cells = std::array<std::uint16_t, kWords>;
    struct Block {
        glm::ivec3 place{0};  ///< of its lowest corner, in blocks
        Cells cells{};
    };

    bool empty() const { return blocks_.empty(); }
    /// Adds every cell that a straight way crosses. @param from_m, to_m [3] metres,
    /// world; what is not finite adds nothing
    void add(const glm::dvec3& from_m, const glm::dvec3& to_m);
    void add(const Block& block);
    void add(const Coverage& other);
    /// Share of a way that lies in cells of the set, 0..1. @param from_m, to_m [3]
    /// metres, world @return 0 for a way that is not finite
    double share(const glm::dvec3& from_m, const glm::dvec3& to_m) const;
    /// In ascending order of their places.
    std::vector<Block> blocks() const;

private:
    std::unordered_map<std::uint64_t, Block> blocks_;  ///< by place
};

/// Where the rays of some scans have looked. A returned ray has looked as far as its
/// point. A dropped one looked as far as the nearer of the returns above and below it in
/// its firing, or to the end of its range where it passes above all of them; else it
/// tells nothing. Between two beams of a firing all is looked at as far as the nearer of
/// the two sees.
/// @param world_from_vehicle  poses of the vehicle at the times of the frames
/// @param positions  of the frames to look at, in Sequence::frames
/// @param max_range_m  how far a ray looks at most
Coverage find_coverage(const Sequence& sequence, const PoseTrack& world_from_vehicle,
                       const std::vector<int>& positions, double max_range_m);

}  // namespace relidar
