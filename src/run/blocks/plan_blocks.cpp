// SPDX-License-Identifier: Apache-2.0
// Divides a log into blocks, which are trained separately. A surfel belongs to the block
// whose sweeps are nearest.
#include <relidar/run/blocks.hpp>

#include <algorithm>
#include <cmath>

#include "base/fail.hpp"
#include "base/geometry/nearest_place.hpp"
#include "run/blocks/frame_places.hpp"

namespace relidar {
namespace {

/// Divides the route into sections of equal length, and returns the sweeps in each
/// section as a block. Sections without sweeps are left out.
std::vector<TrajectoryBlock> divide_route(const std::vector<double>& distances_m, double length_m) {
    const double driven_length_m = distances_m.back();
    const double n = std::max(1.0, std::ceil(driven_length_m / length_m - 1e-9));
    std::vector<TrajectoryBlock> blocks;
    for (std::size_t i = 0; i < distances_m.size(); ++i) {
        const double k =
            driven_length_m > 0.0 ? std::min(n - 1.0, std::floor(distances_m[i] / driven_length_m * n)) : 0.0;
        const double begin_m = driven_length_m * k / n;
        if (blocks.empty() || blocks.back().begin_m < begin_m)
            blocks.push_back({begin_m, driven_length_m * (k + 1.0) / n, {}, {}});
        blocks.back().recorded_frames.push_back(static_cast<int>(i));
    }
    return blocks;
}

bool is_near_any(const glm::dvec3& query_position, const std::vector<glm::dvec3>& all_positions,
                 const std::vector<int>& position_indices, double max_distance_m) {
    return std::any_of(position_indices.begin(), position_indices.end(), [&](int index) {
        return glm::distance(query_position, all_positions[std::size_t(index)]) <= max_distance_m;
    });
}

}  // namespace

std::vector<TrajectoryBlock> plan_blocks(const Log& log, const Split& split, const BlockConfig& options) {
    const std::vector<glm::dvec3> vehicle_positions = list_positions(log);
    std::vector<double> cumulative_distances_m(vehicle_positions.size(), 0.0);
    for (std::size_t i = 1; i < vehicle_positions.size(); ++i)
        cumulative_distances_m[i] =
            cumulative_distances_m[i - 1] + glm::distance(vehicle_positions[i - 1], vehicle_positions[i]);
    std::vector<TrajectoryBlock> blocks = divide_route(cumulative_distances_m, options.length_m);
    // A block is trained on all training frames within halo_m of its recorded frames.
    for (TrajectoryBlock& block : blocks) {
        for (const int position : split.train)
            if (is_near_any(vehicle_positions[std::size_t(position)], vehicle_positions,
                            block.recorded_frames, options.halo_m))
                block.train.push_back(position);
        if (block.train.empty())
            fail(
                "cannot divide {} into blocks: within {:g} m of the block that covers metres {:.0f} to "
                "{:.0f} of the trajectory, no frame is used for training; hold out fewer frames there "
                "(settings dataset.test_every and dataset.test_frames)",
                log.name, options.halo_m, block.begin_m, block.end_m);
    }
    return blocks;
}

/// Keeps the background surfels whose nearest sweep belongs to the block, in kd-tree
/// order. Actors keep all surfels.
void keep_block_surfels(Scene& scene, const Log& log, const std::vector<TrajectoryBlock>& blocks,
                        std::size_t index) {
    std::vector<bool> is_block_frame(log.frames.size(), false);
    for (const int position : blocks[index].recorded_frames) is_block_frame[std::size_t(position)] = true;
    const NearestPointFinder<double> nearest(list_positions(log));
    const std::uint32_t n = scene.models.front().count;
    std::vector<glm::vec3> means;
    std::vector<std::uint32_t> remaining_surfels;
    for (std::uint32_t i = 0; i < n; ++i) {
        if (!is_block_frame[nearest.nearest_index(glm::dvec3(scene.surfels.mean[i]))]) continue;
        remaining_surfels.push_back(i);
        means.push_back(scene.surfels.mean[i]);
    }
    std::vector<std::uint32_t> order;
    for (const std::uint32_t i : kd_tree_order(means)) order.push_back(remaining_surfels[i]);
    for (std::uint32_t i = n; i < scene.surfels.size(); ++i) order.push_back(i);
    scene.surfels = scene.surfels.reorder(order);
    const auto n_removed = static_cast<std::uint32_t>(n - remaining_surfels.size());
    scene.models.front().count -= n_removed;
    for (std::size_t m = 1; m < scene.models.size(); ++m) scene.models[m].first -= n_removed;
}

}  // namespace relidar
