// SPDX-License-Identifier: Apache-2.0
// The set of grid cells that segments have crossed, and the space that the scans of a log
// have observed, column by column.
#include <relidar/log/coverage.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <mutex>
#include <tuple>

#include "base/geometry/cell_key.hpp"
#include "base/parallel.hpp"

namespace relidar {
namespace {

constexpr int kBlockEdgeCells = ObservedVoxelSet::kBlockCells;
// Keys of blocks are unique only up to 8e6 m.
constexpr double kFarthestPoint_m = 1e6;

struct VoxelAddress {
    glm::ivec3 block;
    std::uint32_t word, bit;
};

VoxelAddress locate_cell(const glm::ivec3& cell) {
    const glm::ivec3 within = cell & 7;
    const auto index = std::uint32_t(within.x + kBlockEdgeCells * (within.y + kBlockEdgeCells * within.z));
    return {cell >> 3, index / 16, index % 16};
}

std::uint64_t make_block_key(const glm::ivec3& block) { return grid_key(glm::dvec3(block), 1.0); }

bool is_addressable(const glm::dvec3& point_m) {
    return glm::all(glm::lessThan(glm::abs(point_m), glm::dvec3(kFarthestPoint_m)));
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
        const bool moves = displacement[axis] != 0.0;
        pace[axis] = moves ? 1.0 / std::abs(displacement[axis]) : INFINITY;
        next[axis] = moves ? (border - a[axis]) / displacement[axis] : INFINITY;
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
        std::uint16_t& word = block->cells[cell_address.word];
        word = std::uint16_t(word | 1u << cell_address.bit);
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
        if (block && block->cells[cell_address.word] >> cell_address.bit & 1u) within_m += crossed_m;
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

namespace {

struct RaySegment {
    WorldRay ray;
    double length_m = 0.0;  ///< length of the observed path; 0 if the ray gives no information
};

/// Returns the observed length of each ray of a column, highest beam first. A dropped ray
/// has observed space only if a lower ray has a return: up to the nearer of the next
/// returns above and below, or up to max_range_m without a return above.
/// @param ranges_m  [rows] 0 if the ray was dropped
std::vector<double> observed_lengths_m(const std::vector<double>& ranges_m, double max_range_m) {
    const std::size_t n = ranges_m.size();
    std::vector<double> above(n, 0.0), result(n, 0.0);  // range of the nearest return above each row
    for (std::size_t row = 1; row < n; ++row)
        above[row] = ranges_m[row - 1] > 0.0 ? ranges_m[row - 1] : above[row - 1];
    double below = 0.0;
    for (std::size_t row = n; row-- > 0;) {
        if (ranges_m[row] > 0.0) below = result[row] = ranges_m[row];
        else if (below > 0.0) result[row] = above[row] > 0.0 ? std::min(above[row], below) : max_range_m;
    }
    return result;
}

/// Marks the space between two neighbouring rays as observed, up to the shorter ray.
/// Otherwise cells between diverging rays would stay unobserved.
void fill_between(ObservedVoxelSet& coverage, const RaySegment& first_ray, const RaySegment& second_ray) {
    const double length_m = std::min(first_ray.length_m, second_ray.length_m);
    const int n = int(length_m * glm::distance(first_ray.ray.direction, second_ray.ray.direction) /
                      ObservedVoxelSet::kCell_m);
    for (int k = 1; k <= n; ++k) {
        const double s = double(k) / (n + 1);
        const glm::dvec3 origin_m = glm::mix(first_ray.ray.origin_m, second_ray.ray.origin_m, s);
        coverage.add_segment(origin_m,
                             origin_m + length_m * glm::normalize(glm::mix(first_ray.ray.direction,
                                                                           second_ray.ray.direction, s)));
    }
}

ObservedVoxelSet observe_frame(const Log& sequence, const PoseTrack& world_from_sensor, const Frame& frame,
                               double max_range_m) {
    ObservedVoxelSet coverage;
    const Scan& scan = frame.scan;
    const std::size_t columns = std::size_t(std::max(scan.rays.columns, 1)),
                      rows = scan.range_m.size() / columns;
    // Uses only every `step`-th column, at most every 16th, because the columns in
    // between cross the same grid cells.
    std::size_t step = 1;
    if (rows > 1) {
        const int sensor_columns = sequence.lidar_of(frame).sensor.columns;
        const double step_m =
            sensor_columns > 0 ? 2.0 * kPi / sensor_columns * max_range_m : ObservedVoxelSet::kCell_m;
        step = std::size_t(std::clamp(ObservedVoxelSet::kCell_m / step_m, 1.0, 16.0));
    }
    std::vector<double> range_m(rows);
    std::vector<RaySegment> looks(rows);
    for (std::size_t column = 0; column < columns; column += step) {
        for (std::size_t row = 0; row < rows; ++row)
            range_m[row] = std::min(double(scan.range_m[row * columns + column]), max_range_m);
        const std::vector<double> length_m = observed_lengths_m(range_m, max_range_m);
        for (std::size_t row = 0; row < rows; ++row) {
            looks[row].length_m = length_m[row];
            if (!(length_m[row] > 0.0)) continue;
            looks[row].ray = make_world_ray(world_from_sensor, frame.time_s, scan.rays,
                                            row * columns + column, sequence.rolling_shutter);
            const WorldRay& ray = looks[row].ray;
            coverage.add_segment(ray.origin_m, ray.origin_m + length_m[row] * ray.direction);
            if (row > 0 && looks[row - 1].length_m > 0.0) fill_between(coverage, looks[row - 1], looks[row]);
        }
    }
    return coverage;
}

}  // namespace

ObservedVoxelSet observe_coverage(const Log& sequence, const PoseTrack& world_from_vehicle,
                                  const std::vector<int>& frame_indices, double max_range_m) {
    std::vector<PoseTrack> world_from_sensor;
    for (const Lidar& lidar : sequence.lidars)
        world_from_sensor.push_back(mount_track(world_from_vehicle, lidar.vehicle_from_sensor));
    ObservedVoxelSet all;
    std::mutex mutex;
    parallel_for(int(frame_indices.size()), [&](int index) {
        const Frame& frame = sequence.frames[std::size_t(frame_indices[std::size_t(index)])];
        const ObservedVoxelSet one =
            observe_frame(sequence, world_from_sensor[std::size_t(frame.lidar)], frame, max_range_m);
        const std::lock_guard lock(mutex);
        all.merge(one);
    });
    return all;
}

}  // namespace relidar
