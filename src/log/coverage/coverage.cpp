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
static_assert(kBlockEdgeCells == 8, "locate_cell() divides by 8 with bit operations");
// Keys of blocks are unique only up to 8e6 m.
constexpr double kFarthestPoint_m = 1e6;

struct VoxelAddress {
    glm::ivec3 block;
    std::uint32_t word, bit;
};

/// Returns the block of a cell, and its bit in the words (16 bits) of the block.
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
/// along the segment (Amanatides and Woo 1987).
template <class Visit>
void walk_cells(const glm::dvec3& start_m, const glm::dvec3& end_m, const Visit& visit_cell) {
    if (!is_addressable(start_m) || !is_addressable(end_m)) return;
    // In units of cells.
    const glm::dvec3 start = start_m / ObservedVoxelSet::kCell_m,
                     displacement = (end_m - start_m) / ObservedVoxelSet::kCell_m;
    glm::ivec3 cell(glm::floor(start));
    const glm::ivec3 last_cell(glm::floor(start + displacement));
    const double length_m = glm::distance(start_m, end_m);
    glm::ivec3 cell_step;
    // Per axis, in segment lengths: the next cell border, and the border spacing.
    glm::dvec3 next_border, border_step;
    int n_borders = 0;
    for (int axis = 0; axis < 3; ++axis) {
        const bool is_moving = displacement[axis] != 0.0, is_forward = displacement[axis] > 0.0;
        const double border = cell[axis] + (is_forward ? 1.0 : 0.0);
        cell_step[axis] = is_forward ? 1 : -1;
        border_step[axis] = is_moving ? 1.0 / std::abs(displacement[axis]) : INFINITY;
        next_border[axis] = is_moving ? (border - start[axis]) / displacement[axis] : INFINITY;
        n_borders += std::abs(last_cell[axis] - cell[axis]);
    }
    double position = 0.0;  // fraction of the segment
    for (int k = 0; k < n_borders; ++k) {
        // Axis of the nearest border. Of equally near borders, the lowest axis is first.
        int axis = next_border.x <= next_border.y ? 0 : 1;
        if (next_border.z < next_border[axis]) axis = 2;
        visit_cell(cell, std::max(next_border[axis] - position, 0.0) * length_m);
        position = std::max(next_border[axis], position);
        cell[axis] += cell_step[axis];
        next_border[axis] += border_step[axis];
    }
    visit_cell(cell, std::max(1.0 - position, 0.0) * length_m);
}

}  // namespace

void ObservedVoxelSet::add_segment(const glm::dvec3& start_m, const glm::dvec3& end_m) {
    VoxelBlock* block = nullptr;  // last used block; the next cell is usually in the same block
    walk_cells(start_m, end_m, [&](const glm::ivec3& cell, double) {
        const VoxelAddress cell_address = locate_cell(cell);
        if (!block || block->grid_index != cell_address.block) {
            block = &blocks_[make_block_key(cell_address.block)];
            block->grid_index = cell_address.block;
        }
        std::uint16_t& word = block->cells[cell_address.word];  // one bit for each of 16 cells
        word = std::uint16_t(word | (1u << cell_address.bit));
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
    glm::ivec3 block_index(std::numeric_limits<int>::max());  // of `block`
    walk_cells(start_m, end_m, [&](const glm::ivec3& cell, double crossed_m) {
        const VoxelAddress cell_address = locate_cell(cell);
        // Looks for the block only when the segment enters another block.
        if (cell_address.block != block_index) {
            block_index = cell_address.block;
            const auto block_entry = blocks_.find(make_block_key(block_index));
            block = block_entry == blocks_.end() ? nullptr : &block_entry->second;
        }
        length_m += crossed_m;
        const unsigned word = block ? block->cells[cell_address.word] : 0u;  // bits of 16 cells
        if ((word >> cell_address.bit) & 1u) within_m += crossed_m;
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
    WorldRay ray;           ///< valid only if the length is above 0
    double length_m = 0.0;  ///< length of the observed path; 0 if the ray gives no information
};

/// Returns the observed length of each ray of a column, highest beam first. A dropped ray
/// above all returns points to the sky, so it has observed the space up to max_range_m. A
/// ray between two returns probably hit a surface near the nearer one, which did not
/// reflect. A ray below all returns may have hit something at any distance, so its length
/// is 0.
/// @param ranges_m  [rows] 0 if the ray was dropped
std::vector<double> observed_lengths_m(const std::vector<double>& ranges_m, double max_range_m) {
    const std::size_t n_rows = ranges_m.size();
    std::vector<double> range_above_m(n_rows, 0.0);  // of the next return above each row; 0: none
    for (std::size_t row = 1; row < n_rows; ++row)
        range_above_m[row] = ranges_m[row - 1] > 0.0 ? ranges_m[row - 1] : range_above_m[row - 1];

    std::vector<double> lengths_m(n_rows, 0.0);
    double range_below_m = 0.0;  // of the next return below
    for (std::size_t row = n_rows; row-- > 0;) {
        if (ranges_m[row] > 0.0) {
            lengths_m[row] = ranges_m[row];
            range_below_m = ranges_m[row];
        } else if (range_below_m > 0.0) {
            const bool has_return_above = range_above_m[row] > 0.0;
            lengths_m[row] = has_return_above ? std::min(range_above_m[row], range_below_m) : max_range_m;
        }
    }
    return lengths_m;
}

/// Marks the space between two neighbouring rays as observed, up to the shorter ray.
/// Otherwise cells between diverging rays would stay unobserved. Adds so many rays in
/// between that their ends are about a cell apart.
void fill_between(ObservedVoxelSet& coverage, const RaySegment& first_ray, const RaySegment& second_ray) {
    const WorldRay &first = first_ray.ray, &second = second_ray.ray;
    const double length_m = std::min(first_ray.length_m, second_ray.length_m);
    const int n_between =
        int(length_m * glm::distance(first.direction, second.direction) / ObservedVoxelSet::kCell_m);
    for (int k = 1; k <= n_between; ++k) {
        const double share = double(k) / (n_between + 1);
        const glm::dvec3 origin_m = glm::mix(first.origin_m, second.origin_m, share);
        const glm::dvec3 direction = glm::normalize(glm::mix(first.direction, second.direction, share));
        coverage.add_segment(origin_m, origin_m + length_m * direction);
    }
}

/// Returns n if every n-th column of a scan is enough, because the columns in between
/// cross the same grid cells even at max_range_m.
std::size_t choose_column_step(const SpinningSensor& sensor, std::size_t n_rows, double max_range_m) {
    constexpr double kMaxColumnStep = 16.0;
    if (n_rows <= 1) return 1;
    const double column_distance_m =
        sensor.columns > 0 ? 2.0 * kPi / sensor.columns * max_range_m : ObservedVoxelSet::kCell_m;
    return std::size_t(std::clamp(ObservedVoxelSet::kCell_m / column_distance_m, 1.0, kMaxColumnStep));
}

/// Returns the space that one scan has observed: the cells along each ray, up to its
/// observed length, and between neighbouring rays of a column.
ObservedVoxelSet observe_frame(const Log& log, const PoseTrack& world_from_sensor, const Frame& frame,
                               double max_range_m) {
    ObservedVoxelSet observed;
    const Scan& scan = frame.scan;
    const std::size_t columns = std::size_t(std::max(scan.rays.columns, 1)),
                      rows = scan.range_m.size() / columns;
    const std::size_t column_step = choose_column_step(log.lidar_of(frame).sensor, rows, max_range_m);
    const BodyTable& own_body = log.lidar_of(frame).own_body;
    // Of the current column, from the highest beam to the lowest.
    std::vector<double> range_m(rows);
    std::vector<RaySegment> segments(rows);
    for (std::size_t column = 0; column < columns; column += column_step) {
        for (std::size_t row = 0; row < rows; ++row)
            range_m[row] = std::min(double(scan.range_m[row * columns + column]), max_range_m);
        const std::vector<double> length_m = observed_lengths_m(range_m, max_range_m);
        for (std::size_t row = 0; row < rows; ++row) {
            RaySegment& segment = segments[row];
            const std::size_t ray = row * columns + column;
            // A dropped ray does not see past the body that carries the LiDAR.
            const bool is_hidden = own_body.hides(scan.rays.direction[ray], scan.range_m[ray]);
            segment.length_m = is_hidden ? 0.0 : length_m[row];
            if (!(segment.length_m > 0.0)) continue;
            segment.ray =
                make_world_ray(world_from_sensor, frame.time_s, scan.rays, ray, log.rolling_shutter);
            observed.add_segment(segment.ray.origin_m,
                                 segment.ray.origin_m + length_m[row] * segment.ray.direction);
            if (row > 0 && segments[row - 1].length_m > 0.0)
                fill_between(observed, segments[row - 1], segment);
        }
    }
    return observed;
}

}  // namespace

ObservedVoxelSet observe_coverage(const Log& log, const PoseTrack& world_from_vehicle,
                                  const std::vector<int>& frame_indices, double max_range_m) {
    std::vector<PoseTrack> world_from_sensor;
    for (const Lidar& lidar : log.lidars)
        world_from_sensor.push_back(mount_track(world_from_vehicle, lidar.vehicle_from_sensor));
    ObservedVoxelSet observed;  // a union, so the order of the frames does not matter
    std::mutex mutex;
    parallel_for(int(frame_indices.size()), [&](int index) {
        const Frame& frame = log.frames[std::size_t(frame_indices[std::size_t(index)])];
        const ObservedVoxelSet observed_by_frame =
            observe_frame(log, world_from_sensor[std::size_t(frame.lidar)], frame, max_range_m);
        const std::lock_guard lock(mutex);
        observed.merge(observed_by_frame);
    });
    return observed;
}

}  // namespace relidar
