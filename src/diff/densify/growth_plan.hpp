// SPDX-License-Identifier: Apache-2.0
// Computes the number of new surfels and the new surfel range of each model, from the
// number of surfels per action. Used only by densification.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include <relidar/diff/densify.hpp>
#include <relidar/scene/device_scene.hpp>

#include "diff/shared/densify.h"

namespace relidar {

/// Number of surfels of one model for each action of the densification. The index is
/// RELIDAR_DENSIFY_KEPT or one of the constants that follow it.
using ModelCounts = std::array<std::uint32_t, RELIDAR_DENSIFY_COUNTERS>;

struct GrowthPlan {
    std::uint32_t survivors = 0;
    std::uint32_t total_weight = 0;
    std::uint32_t n_new = 0;  ///< number of copies to distribute
    std::uint32_t phase = 0;  ///< phase of the systematic sampling, below total_weight

    std::uint32_t size() const { return survivors + n_new; }
    /// Returns the number of copies that all surfels before a position receive together.
    /// Must use the same formula as kernel diff/densify/allot.
    /// @param weight sum of the weights of these surfels
    std::uint32_t sum_earlier_weights(std::uint64_t weight) const;
    /// Returns copies of the models with their new surfel ranges.
    std::vector<Model> ranges(std::vector<Model> models, const std::vector<ModelCounts>& counts) const;
};

/// Plans the growth of all models. All survivors stay, and each growing surfel adds one
/// new surfel, up to DensifyOptions::max_surfels in total.
/// @param random random number that selects the surfels whose copies are rounded up
GrowthPlan plan_growth(const std::vector<ModelCounts>& counts, const DensifyOptions& options,
                       std::uint64_t random);
/// Reduces the number of new surfels so that the total is at most `size`. Survivors
/// always stay.
GrowthPlan limit_growth_plan(GrowthPlan plan, std::uint32_t size);

/// Adds the counts of all models and returns them as a report.
DensifyReport report_of(const std::vector<ModelCounts>& counts, const GrowthPlan& plan);

}  // namespace relidar
