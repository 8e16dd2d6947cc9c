// SPDX-License-Identifier: Apache-2.0
#include "diff/densify/growth_plan.hpp"

#include <algorithm>

namespace relidar {

std::uint32_t GrowthPlan::cumulative_copies(std::uint64_t cumulative_weight) const {
    return total_weight == 0 ? 0u : std::uint32_t((cumulative_weight * n_new + phase) / total_weight);
}

/// Returns the models with their surfel ranges after surfels were added and removed.
std::vector<SurfelModel> GrowthPlan::assign_ranges(std::vector<SurfelModel> m, const ModelCounts& c) const {
    std::uint32_t next = 0;
    std::uint64_t weight = 0;
    for (std::size_t i = 0; i < m.size(); ++i) {
        const std::uint64_t above = weight + c[i][RELIDAR_DENSIFY_WEIGHT];
        m[i].first = next;
        m[i].count = c[i][RELIDAR_DENSIFY_KEPT] + cumulative_copies(above) - cumulative_copies(weight);
        next += m[i].count;
        weight = above;
    }
    return m;
}

GrowthPlan plan_growth(const ModelCounts& counts, const DensifyOptions& o, std::uint64_t random) {
    GrowthPlan plan;
    for (const ModelCounters& c : counts) {
        plan.survivors += c[RELIDAR_DENSIFY_KEPT];
        plan.total_weight += c[RELIDAR_DENSIFY_WEIGHT];
    }
    if (plan.total_weight == 0) return plan;
    // The random phase selects the copied surfels if max_surfels limits their number.
    plan.phase = std::uint32_t(random % plan.total_weight);
    plan.n_new = plan.total_weight;  // one new surfel per growing surfel, because each has weight 1
    return limit_growth(plan, std::uint32_t(o.max_surfels));
}

GrowthPlan limit_growth(GrowthPlan plan, std::uint32_t max_surfels) {
    plan.n_new = std::min(plan.n_new, max_surfels > plan.survivors ? max_surfels - plan.survivors : 0u);
    return plan;
}

DensifyReport densify_report(const ModelCounts& counts, const GrowthPlan& plan) {
    DensifyReport r;
    for (const ModelCounters& c : counts) {
        r.invalid += c[RELIDAR_DENSIFY_INVALID];
        r.faint += c[RELIDAR_DENSIFY_FAINT];
        r.large += c[RELIDAR_DENSIFY_LARGE];
        r.outside += c[RELIDAR_DENSIFY_OUTSIDE];
        r.clones += c[RELIDAR_DENSIFY_CLONES];
        r.splits += c[RELIDAR_DENSIFY_SPLITS];
    }
    r.before = plan.survivors + r.n_removed();
    r.added = plan.n_new;
    r.after = plan.size();
    return r;
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
