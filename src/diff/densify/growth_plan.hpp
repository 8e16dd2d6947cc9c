// SPDX-License-Identifier: Apache-2.0
// Computes the number of new surfels and the new range of each model. The input is the
// number of surfels of each class. Used only by densify.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include <relidar/diff/densify.hpp>
#include <relidar/scene/device_scene.hpp>

#include "diff/shared/densify.h"

namespace relidar {

/// Number of surfels of one model per outcome. The index is RELIDAR_DENSIFY_KEPT and so
/// on.
using ModelCounts = std::array<std::uint32_t, RELIDAR_DENSIFY_COUNTERS>;

struct GrowthPlan {
    std::uint32_t survivors = 0;
    std::uint32_t total_weight = 0;
    std::uint32_t n_new = 0;  ///< number of distributed copies
    std::uint32_t phase = 0;  ///< phase of the sampling, below total_weight

    std::uint32_t size() const { return survivors + n_new; }
    /// Returns the number of copies that the surfels before a position receive. The
    /// position is given in the cumulative weights. Must use the same formula as
    /// diff/densify/allot.
    std::uint32_t sum_before(std::uint64_t weight) const;
    /// Returns the models with their new ranges.
    std::vector<Model> ranges(std::vector<Model> models, const std::vector<ModelCounts>& counts) const;
};

/// Plans the growth of all models: all survivors, plus one new surfel per growing surfel,
/// up to DensifyOptions::max_surfels.
/// @param random  random number that determines which surfels receive the rounded copies
GrowthPlan plan_growth(const std::vector<ModelCounts>& counts, const DensifyOptions& options,
                       std::uint64_t random);
/// Reduces the number of new surfels of a plan to reach a total size. Survivors always
/// stay.
GrowthPlan limited_to(GrowthPlan plan, std::uint32_t size);

/// Sums the counts of all models into a report.
DensifyReport report_of(const std::vector<ModelCounts>& counts, const GrowthPlan& plan);

}  // namespace relidar
