// SPDX-License-Identifier: Apache-2.0
// Divides a log into blocks, which are trained separately. Selects the sweeps that each
// block uses. A surfel belongs to the block whose sweeps are nearest.
#include <relidar/run/blocks.hpp>

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/nearest_place.hpp"
#include "run/blocks/frame_places.hpp"

namespace relidar {
namespace {

/// Returns, for each position of the vehicle, the distance in metres that it has driven
/// so far.
std::vector<double> compute_driven_distances(const std::vector<glm::dvec3>& places) {
    std::vector<double> metres(places.size(), 0.0);
    for (std::size_t i = 1; i < places.size(); ++i)
        metres[i] = metres[i - 1] + glm::distance(places[i - 1], places[i]);
    return metres;
}

/// Divides the route into sections of equal length, and returns the sweeps in each
/// section as a block. Sections without sweeps are left out.
std::vector<Block> divide_route(const std::vector<double>& metres, double length_m) {
    const double driven_length_m = metres.back();
    const double n = std::max(1.0, std::ceil(driven_length_m / length_m - 1e-9));
    std::vector<Block> blocks;
    for (std::size_t i = 0; i < metres.size(); ++i) {
        const double k =
            driven_length_m > 0.0 ? std::min(n - 1.0, std::floor(metres[i] / driven_length_m * n)) : 0.0;
        const double begin_m = driven_length_m * k / n;
        if (blocks.empty() || blocks.back().begin_m < begin_m)
            blocks.push_back({begin_m, driven_length_m * (k + 1.0) / n, {}, {}});
        blocks.back().own.push_back(static_cast<int>(i));
    }
    return blocks;
}

bool is_near_any(const glm::dvec3& place, const std::vector<glm::dvec3>& places,
                 const std::vector<int>& indices, double within_m) {
    return std::any_of(indices.begin(), indices.end(), [&](int index) {
        return glm::distance(place, places[std::size_t(index)]) <= within_m;
    });
}

}  // namespace

std::vector<Block> plan_blocks(const Sequence& sequence, const Split& split, const BlockConfig& options) {
    const std::vector<glm::dvec3> places = compute_frame_positions(sequence);
    std::vector<Block> blocks = divide_route(compute_driven_distances(places), options.length_m);
    for (Block& block : blocks) {
        for (const int position : split.train)
            if (is_near_any(places[std::size_t(position)], places, block.own, options.halo_m))
                block.train.push_back(position);
        if (block.train.empty())
            throw DataError(fmt::format(
                "cannot divide {} into blocks: the part of its trajectory within {:g} m of metres {:.0f} "
                "to {:.0f} has no training frame; hold out fewer frames there (settings "
                "dataset.test_every and dataset.test_frames)",
                sequence.name, options.halo_m, block.begin_m, block.end_m));
    }
    return blocks;
}

void remove_overlap_surfels(Scene& scene, const Sequence& sequence, const std::vector<Block>& blocks,
                            std::size_t block) {
    std::vector<bool> is_own(sequence.frames.size(), false);
    for (const int position : blocks[block].own) is_own[std::size_t(position)] = true;
    const NearestPlace<double> nearest(compute_frame_positions(sequence));
    const std::uint32_t n = scene.models.front().count;
    std::vector<glm::vec3> means;
    std::vector<std::uint32_t> kept;
    for (std::uint32_t i = 0; i < n; ++i) {
        if (!is_own[nearest.of(glm::dvec3(scene.surfels.mean[i]))]) continue;
        kept.push_back(i);
        means.push_back(scene.surfels.mean[i]);
    }
    std::vector<std::uint32_t> order;
    for (const std::uint32_t i : compute_kd_order(means)) order.push_back(kept[i]);
    for (std::uint32_t i = n; i < scene.surfels.size(); ++i) order.push_back(i);
    scene.surfels = scene.surfels.reorder(order);
    const auto gone = static_cast<std::uint32_t>(n - kept.size());
    scene.models.front().count -= gone;
    for (std::size_t m = 1; m < scene.models.size(); ++m) scene.models[m].first -= gone;
}

}  // namespace relidar
