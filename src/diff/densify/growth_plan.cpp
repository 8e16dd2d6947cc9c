// SPDX-License-Identifier: Apache-2.0
// Computes the number of surfels after a densification from the number of surfels per
// action.
#include "diff/densify/growth_plan.hpp"

#include <algorithm>

namespace relidar {

std::uint32_t GrowthPlan::sum_earlier_weights(std::uint64_t weight) const {
    return total_weight == 0 ? 0u : static_cast<std::uint32_t>((weight * n_new + phase) / total_weight);
}

std::vector<Model> GrowthPlan::ranges(std::vector<Model> models,
                                      const std::vector<ModelCounts>& counts) const {
    std::uint32_t next = 0;
    std::uint64_t weight = 0;
    for (std::size_t i = 0; i < models.size(); ++i) {
        const std::uint64_t above = weight + counts[i][RELIDAR_DENSIFY_WEIGHT];
        models[i].first = next;
        models[i].count =
            counts[i][RELIDAR_DENSIFY_KEPT] + sum_earlier_weights(above) - sum_earlier_weights(weight);
        next += models[i].count;
        weight = above;
    }
    return models;
}

GrowthPlan plan_growth(const std::vector<ModelCounts>& counts, const DensifyOptions& options,
                       std::uint64_t random) {
    GrowthPlan plan;
    for (const ModelCounts& c : counts) {
        plan.survivors += c[RELIDAR_DENSIFY_KEPT];
        plan.total_weight += c[RELIDAR_DENSIFY_WEIGHT];
    }
    if (plan.total_weight == 0) return plan;
    plan.phase = static_cast<std::uint32_t>(random % plan.total_weight);
    plan.n_new = plan.total_weight;  // one new surfel per growing surfel, because each has weight 1
    return limit_growth_plan(plan, static_cast<std::uint32_t>(options.max_surfels));
}

GrowthPlan limit_growth_plan(GrowthPlan plan, std::uint32_t size) {
    plan.n_new = std::min(plan.n_new, size > plan.survivors ? size - plan.survivors : 0u);
    return plan;
}

DensifyReport make_densify_report(const std::vector<ModelCounts>& counts, const GrowthPlan& plan) {
    DensifyReport r;
    for (const ModelCounts& c : counts) {
        r.invalid += c[RELIDAR_DENSIFY_INVALID];
        r.faint += c[RELIDAR_DENSIFY_FAINT];
        r.large += c[RELIDAR_DENSIFY_LARGE];
        r.outside += c[RELIDAR_DENSIFY_OUTSIDE];
        r.clones += c[RELIDAR_DENSIFY_CLONES];
        r.splits += c[RELIDAR_DENSIFY_SPLITS];
    }
    r.before = plan.survivors + r.removed();
    r.added = plan.n_new;
    r.after = plan.size();
    return r;
}

void DensifyReport::add(const DensifyReport& report) {
    before = report.before;
    after = report.after;
    added += report.added;
    clones += report.clones;
    splits += report.splits;
    invalid += report.invalid;
    faint += report.faint;
    large += report.large;
    outside += report.outside;
    if (!report.note.empty()) note = report.note;
}

}  // namespace relidar
