// SPDX-License-Identifier: Apache-2.0
// Computes how many surfels a densification adds, and the new surfel range of each model.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include <relidar/diff/densify.hpp>
#include <relidar/scene/device_scene.hpp>

#include "diff/shared/densify.h"

namespace relidar {

/// Numbers of surfels of one model that are kept, dropped for each reason, cloned and
/// split. RELIDAR_DENSIFY_KEPT and the following constants are the indices.
using ModelCounters = std::array<std::uint32_t, RELIDAR_DENSIFY_COUNTERS>;
using ModelCounts = std::vector<ModelCounters>;  ///< one row per model

struct GrowthPlan {
    std::uint32_t survivors = 0;     ///< surfels that are not removed
    std::uint32_t total_weight = 0;  ///< sum of the weights of growing surfels
    std::uint32_t n_new = 0;         ///< number of copies to distribute
    /// Random number below total_weight. It selects which surfels get the copies, if
    /// there are fewer copies than growing surfels (systematic sampling).
    std::uint32_t phase = 0;

    std::uint32_t size() const { return survivors + n_new; }
    /// Returns how many of the `n_new` copies the first k surfels get together:
    /// floor((cumulative_weight * n_new + phase) / total_weight), like kernel allot.
    /// @param cumulative_weight sum of the weights of the first k surfels
    std::uint32_t cumulative_copies(std::uint64_t cumulative_weight) const;
    std::vector<SurfelModel> assign_ranges(std::vector<SurfelModel> models, const ModelCounts& counts) const;
};

/// Plans how many surfels densification adds: one copy of each surfel that is marked for
/// growth, until the total reaches DensifyOptions::max_surfels.
/// @param random selects which surfels are copied if max_surfels is reached
GrowthPlan plan_growth(const ModelCounts& counts, const DensifyOptions& o, std::uint64_t random);
/// Reduces the number of added surfels until the total is at most `max_surfels`. Does not
/// remove existing surfels.
GrowthPlan limit_growth(GrowthPlan plan, std::uint32_t max_surfels);

/// Sums the counters of all models into the report of one densification.
DensifyReport densify_report(const ModelCounts& counts, const GrowthPlan& plan);

}  // namespace relidar
