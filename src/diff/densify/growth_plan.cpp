// SPDX-License-Identifier: Apache-2.0
#include "diff/densify/growth_plan.hpp"

#include <algorithm>

namespace relidar {

std::uint32_t GrowthPlan::cumulative_copies(std::uint64_t cumulative_weight) const {
    return total_weight == 0 ? 0u : std::uint32_t((cumulative_weight * n_new + phase) / total_weight);
}

/// Returns the models with their surfel ranges after surfels were added and removed. A
/// model gets its kept surfels and copies. The copies are a difference of two cumulative
/// numbers, because only these are rounded as in kernel diff/densify/allot.
std::vector<SurfelModel> GrowthPlan::assign_ranges(std::vector<SurfelModel> models,
                                                   const ModelCounts& counts) const {
    std::uint32_t first_surfel = 0;
    std::uint64_t weight_before = 0;  // of all earlier models
    for (std::size_t i = 0; i < models.size(); ++i) {
        const std::uint64_t weight_after = weight_before + counts[i][RELIDAR_DENSIFY_WEIGHT];
        const std::uint32_t n_copies = cumulative_copies(weight_after) - cumulative_copies(weight_before);
        models[i].first = first_surfel;
        models[i].count = counts[i][RELIDAR_DENSIFY_KEPT] + n_copies;
        first_surfel += models[i].count;
        weight_before = weight_after;
    }
    return models;
}

GrowthPlan plan_growth(const ModelCounts& counts, const DensifyOptions& o, std::uint64_t random) {
    GrowthPlan plan;
    for (const ModelCounters& model : counts) {
        plan.survivors += model[RELIDAR_DENSIFY_KEPT];
        plan.total_weight += model[RELIDAR_DENSIFY_WEIGHT];
    }
    if (plan.total_weight == 0) return plan;
    // Each growing surfel has weight 1, so the sum is their number. Each gets one copy.
    // If limit_growth() leaves fewer copies, about every n-th growing surfel gets one
    // (systematic sampling), and the random `phase` decides which is the first.
    plan.n_new = plan.total_weight;
    plan.phase = std::uint32_t(random % plan.total_weight);
    return limit_growth(plan, std::uint32_t(o.max_surfels));
}

GrowthPlan limit_growth(GrowthPlan plan, std::uint32_t max_surfels) {
    const std::uint32_t max_new = max_surfels > plan.survivors ? max_surfels - plan.survivors : 0u;
    plan.n_new = std::min(plan.n_new, max_new);
    return plan;
}

DensifyReport densify_report(const ModelCounts& counts, const GrowthPlan& plan) {
    DensifyReport report;
    for (const ModelCounters& model : counts) {
        report.invalid += model[RELIDAR_DENSIFY_INVALID];
        report.faint += model[RELIDAR_DENSIFY_FAINT];
        report.large += model[RELIDAR_DENSIFY_LARGE];
        report.outside += model[RELIDAR_DENSIFY_OUTSIDE];
        report.clones += model[RELIDAR_DENSIFY_CLONES];
        report.splits += model[RELIDAR_DENSIFY_SPLITS];
    }
    report.before = plan.survivors + report.n_removed();
    report.added = plan.n_new;
    report.after = plan.size();
    return report;
}

void DensifyReport::add_counts(const DensifyReport& later_report) {
    before = later_report.before;
    after = later_report.after;
    added += later_report.added;
    clones += later_report.clones;
    splits += later_report.splits;
    invalid += later_report.invalid;
    faint += later_report.faint;
    large += later_report.large;
    outside += later_report.outside;
    if (!later_report.note.empty()) note = later_report.note;
}

}  // namespace relidar
