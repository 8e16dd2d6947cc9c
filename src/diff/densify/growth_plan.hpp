// SPDX-License-Identifier: Apache-2.0
// From the counts that classification leaves to sizes: how many surfels are added, and
// the new range of each model. Private to densify.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include <relidar/diff/densify.hpp>
#include <relidar/scene/device_scene.hpp>

#include "diff/shared/densify.h"

namespace relidar {

/// Counters of one model, RELIDAR_DENSIFY_KEPT and so on.
using ModelCounts = std::array<std::uint32_t, RELIDAR_DENSIFY_COUNTERS>;

struct GrowthPlan {
    std::uint32_t survivors = 0;
    std::uint32_t total_weight = 0;
    std::uint32_t n_new = 0;  ///< copies handed out
    std::uint32_t phase = 0;  ///< of the sampling, below total_weight

    std::uint32_t size() const { return survivors + n_new; }
    /// Copies that go to surfels before a place in the cumulative weights: what
    /// diff/densify/allot computes.
    std::uint32_t allotted_before(std::uint64_t weight) const;
    /// The models with their new ranges.
    std::vector<Model> ranges(std::vector<Model> models, const std::vector<ModelCounts>& counts) const;
};

/// Returns survivors and growth by one surfel for each that grows, up to
/// DensifyOptions::max_surfels. @param random any number: fixes the phase
GrowthPlan plan_growth(const std::vector<ModelCounts>& counts, const DensifyOptions& options,
                       std::uint64_t random);
/// The same with at most so many surfels in all; survivors always stay.
GrowthPlan limited_to(GrowthPlan plan, std::uint32_t size);

/// Counts of all models as a report.
DensifyReport report_of(const std::vector<ModelCounts>& counts, const GrowthPlan& plan);

}  // namespace relidar
