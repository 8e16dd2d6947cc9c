// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/coverage.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>

#include "base/cell_key.hpp"

namespace relidar {
namespace {

constexpr int kEdge = Coverage::kBlockCells;
// Points farther from the origin are ignored, because keys of cell blocks are unique only
// up to 8e6 m.
constexpr double kFarthestPoint_m = 1e6;

struct Place {
    glm::ivec3 block;
    std::uint32_t bit;
};

Place make_cell_location(const glm::ivec3& cell) {
    const glm::ivec3 block = cell >> 3, within = cell & 7;
    return {block, std::uint32_t(within.x + kEdge * (within.y + kEdge * within.z))};
}

std::uint64_t make_block_key(const glm::ivec3& block) { return make_cell_key(glm::dvec3(block), 1.0); }

bool is_in_supported_range(const glm::dvec3& point_m) {
    return std::abs(point_m.x) < kFarthestPoint_m && std::abs(point_m.y) < kFarthestPoint_m &&
           std::abs(point_m.z) < kFarthestPoint_m;
}

/// Calls visit(cell, length_m) for each cell that a line segment crosses, in order along
/// the segment.
template <class Visit>
void visit_cells(const glm::dvec3& from_m, const glm::dvec3& to_m, const Visit& visit) {
    if (!is_in_supported_range(from_m) || !is_in_supported_range(to_m)) return;
    const glm::dvec3 a = from_m / Coverage::kCell_m, way = (to_m - from_m) / Coverage::kCell_m;
    glm::ivec3 cell(glm::floor(a));
    const glm::ivec3 end(glm::floor(a + way));
    const double length_m = glm::distance(from_m, to_m);
    glm::ivec3 step;
    // `next`: where the segment crosses the next cell border along each axis. `pace`:
    // distance between two borders. Both are fractions of the segment.
    glm::dvec3 next, pace;
    int n_borders = 0;
    for (int axis = 0; axis < 3; ++axis) {
        step[axis] = way[axis] > 0.0 ? 1 : -1;
        n_borders += std::abs(end[axis] - cell[axis]);
        const double border = cell[axis] + (way[axis] > 0.0 ? 1.0 : 0.0);
        pace[axis] = way[axis] != 0.0 ? 1.0 / std::abs(way[axis]) : std::numeric_limits<double>::infinity();
        next[axis] =
            way[axis] != 0.0 ? (border - a[axis]) / way[axis] : std::numeric_limits<double>::infinity();
    }
    double at = 0.0;
    for (int border = 0; border < n_borders; ++border) {
        const int axis = next.x <= next.y ? (next.x <= next.z ? 0 : 2) : (next.y <= next.z ? 1 : 2);
        visit(cell, std::max(next[axis] - at, 0.0) * length_m);
        at = std::max(next[axis], at);
        cell[axis] += step[axis];
        next[axis] += pace[axis];
    }
    visit(cell, std::max(1.0 - at, 0.0) * length_m);
}

}  // namespace

void Coverage::add(const glm::dvec3& from_m, const glm::dvec3& to_m) {
    // Block (a group of cells) that was used last, because the next cell is usually in
    // the same block.
    Block* block = nullptr;
    visit_cells(from_m, to_m, [&](const glm::ivec3& cell, double) {
        const Place place = make_cell_location(cell);
        if (!block || block->place != place.block) {
            block = &blocks_[make_block_key(place.block)];
            block->place = place.block;
        }
        block->cells[place.bit / 16] = std::uint16_t(block->cells[place.bit / 16] | 1u << place.bit % 16);
    });
}

void Coverage::add(const Block& block) {
    Block& own = blocks_[make_block_key(block.place)];
    own.place = block.place;
    for (std::size_t w = 0; w < kWords; ++w) own.cells[w] = std::uint16_t(own.cells[w] | block.cells[w]);
}

void Coverage::add(const Coverage& other) {
    for (const auto& [key, block] : other.blocks_) add(block);
}

double Coverage::share(const glm::dvec3& from_m, const glm::dvec3& to_m) const {
    double within_m = 0.0, length_m = 0.0;
    const Block* block = nullptr;
    glm::ivec3 at(std::numeric_limits<int>::max());  // index of the block that `block` points to
    visit_cells(from_m, to_m, [&](const glm::ivec3& cell, double crossed_m) {
        const Place place = make_cell_location(cell);
        if (place.block != at) {
            at = place.block;
            const auto found = blocks_.find(make_block_key(at));
            block = found == blocks_.end() ? nullptr : &found->second;
        }
        length_m += crossed_m;
        if (block && block->cells[place.bit / 16] >> place.bit % 16 & 1u) within_m += crossed_m;
    });
    return length_m > 0.0 ? within_m / length_m : 0.0;
}

std::vector<Coverage::Block> Coverage::blocks() const {
    std::vector<Block> all;
    for (const auto& [key, block] : blocks_) all.push_back(block);
    std::ranges::sort(all, {}, [](const Block& b) { return std::tuple(b.place.x, b.place.y, b.place.z); });
    return all;
}

}  // namespace relidar
