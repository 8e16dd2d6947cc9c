// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/coverage.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>

#include "base/geometry/cell_key.hpp"

namespace relidar {
namespace {

constexpr int kBlockEdgeCells = ObservedVoxelSet::kBlockCells;
// Keys of blocks are unique only up to 8e6 m.
constexpr double kFarthestPoint_m = 1e6;

struct VoxelAddress {
    glm::ivec3 block;
    std::uint32_t bit;
};

VoxelAddress locate_cell(const glm::ivec3& cell) {
    const glm::ivec3 block = cell >> 3, within = cell & 7;
    return {block, std::uint32_t(within.x + kBlockEdgeCells * (within.y + kBlockEdgeCells * within.z))};
}

std::uint64_t make_block_key(const glm::ivec3& block) { return grid_key(glm::dvec3(block), 1.0); }

bool is_addressable(const glm::dvec3& point_m) {
    return std::abs(point_m.x) < kFarthestPoint_m && std::abs(point_m.y) < kFarthestPoint_m &&
           std::abs(point_m.z) < kFarthestPoint_m;
}

/// Calls visit_cell(cell, length_m) for each cell that a line segment crosses, in order
/// along the segment.
template <class Visit>
void walk_cells(const glm::dvec3& start_m, const glm::dvec3& end_m, const Visit& visit_cell) {
    if (!is_addressable(start_m) || !is_addressable(end_m)) return;
    const glm::dvec3 a = start_m / ObservedVoxelSet::kCell_m,
                     displacement = (end_m - start_m) / ObservedVoxelSet::kCell_m;
    glm::ivec3 cell(glm::floor(a));
    const glm::ivec3 end(glm::floor(a + displacement));
    const double length_m = glm::distance(start_m, end_m);
    glm::ivec3 step;
    // Per axis, as fractions of the segment: position of the next cell border, and
    // distance between two borders.
    glm::dvec3 next, pace;
    int n_borders = 0;
    for (int axis = 0; axis < 3; ++axis) {
        step[axis] = displacement[axis] > 0.0 ? 1 : -1;
        n_borders += std::abs(end[axis] - cell[axis]);
        const double border = cell[axis] + (displacement[axis] > 0.0 ? 1.0 : 0.0);
        pace[axis] = displacement[axis] != 0.0 ? 1.0 / std::abs(displacement[axis])
                                               : std::numeric_limits<double>::infinity();
        next[axis] = displacement[axis] != 0.0 ? (border - a[axis]) / displacement[axis]
                                               : std::numeric_limits<double>::infinity();
    }
    double at = 0.0;
    for (int border = 0; border < n_borders; ++border) {
        // Axis of the nearest border. Of equally near borders, the lowest axis is first.
        int axis = next.y <= next.z ? 1 : 2;
        if (next.x <= next.y) axis = next.x <= next.z ? 0 : 2;
        visit_cell(cell, std::max(next[axis] - at, 0.0) * length_m);
        at = std::max(next[axis], at);
        cell[axis] += step[axis];
        next[axis] += pace[axis];
    }
    visit_cell(cell, std::max(1.0 - at, 0.0) * length_m);
}

}  // namespace

void ObservedVoxelSet::add_segment(const glm::dvec3& start_m, const glm::dvec3& end_m) {
    // last used block; the next cell is usually in the same block
    VoxelBlock* block = nullptr;
    walk_cells(start_m, end_m, [&](const glm::ivec3& cell, double) {
        const VoxelAddress cell_address = locate_cell(cell);
        if (!block || block->grid_index != cell_address.block) {
            block = &blocks_[make_block_key(cell_address.block)];
            block->grid_index = cell_address.block;
        }
        // One bit for each cell, in words of 16 bits.
        block->cells[cell_address.bit / 16] =
            std::uint16_t(block->cells[cell_address.bit / 16] | 1u << cell_address.bit % 16);
    });
}

void ObservedVoxelSet::add_block(const VoxelBlock& block) {
    VoxelBlock& target_block = blocks_[make_block_key(block.grid_index)];
    target_block.grid_index = block.grid_index;
    for (std::size_t w = 0; w < kBlockWords; ++w)
        target_block.cells[w] = std::uint16_t(target_block.cells[w] | block.cells[w]);
}

void ObservedVoxelSet::merge(const ObservedVoxelSet& other_set) {
    for (const auto& [key, block] : other_set.blocks_) add_block(block);
}

double ObservedVoxelSet::observed_fraction(const glm::dvec3& start_m, const glm::dvec3& end_m) const {
    double within_m = 0.0, length_m = 0.0;
    const VoxelBlock* block = nullptr;
    glm::ivec3 at(std::numeric_limits<int>::max());  // index of the block that `block` points to
    walk_cells(start_m, end_m, [&](const glm::ivec3& cell, double crossed_m) {
        const VoxelAddress cell_address = locate_cell(cell);
        // Looks for the block only when the segment enters another block.
        if (cell_address.block != at) {
            at = cell_address.block;
            const auto block_entry = blocks_.find(make_block_key(at));
            block = block_entry == blocks_.end() ? nullptr : &block_entry->second;
        }
        length_m += crossed_m;
        if (block && block->cells[cell_address.bit / 16] >> cell_address.bit % 16 & 1u) within_m += crossed_m;
    });
    return length_m > 0.0 ? within_m / length_m : 0.0;
}

std::vector<ObservedVoxelSet::VoxelBlock> ObservedVoxelSet::list_blocks() const {
    std::vector<VoxelBlock> all;
    for (const auto& [key, block] : blocks_) all.push_back(block);
    std::ranges::sort(all, {}, [](const VoxelBlock& b) {
        return std::tuple(b.grid_index.x, b.grid_index.y, b.grid_index.z);
    });
    return all;
}

}  // namespace relidar
