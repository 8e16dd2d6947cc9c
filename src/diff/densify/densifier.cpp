// SPDX-License-Identifier: Apache-2.0
// Host side of densification, which adds and removes surfels. Chooses an action for each
// surfel, reads the counts, allocates memory, distributes copies, moves every array, and
// computes the values of new surfels.
#include <relidar/diff/densify.hpp>

#include <cmath>
#include <limits>

#include <fmt/format.h>

#include <relidar/diff/optimizer.hpp>
#include <relidar/gpu/out_of_memory.hpp>

#include "base/assert.hpp"
#include "base/random.hpp"
#include "diff/densify/rearrange.hpp"
#include "diff/densify/room.hpp"
#include "gpu/stream.hpp"

namespace relidar {

namespace {

constexpr float kUnbounded = std::numeric_limits<float>::infinity();

double logit(double probability) { return std::log(probability / (1.0 - probability)); }

/// Thresholds that decide which surfels are dropped or grow.
struct Rules {
    float min_opacity = 0.0f;
    float max_extent_share = kUnbounded;
};

/// Purpose of random numbers. It is part of their seed, so that different purposes get
/// independent numbers.
enum class Draw : std::uint64_t { classify = 1, phase = 2 };

// Opacity after a reset, relative to alpha_min. Above 1, because a surfel below alpha_min
// is invisible and gets no gradient.
constexpr double kResetOverAlphaMin = 2.5;

}  // namespace

struct Densifier::Impl {
    Device& device;
    DensifyOptions options;
    float min_opacity;
    double reset_opacity_to;
    std::uint64_t seed;
    std::vector<double> extents_m;
    Rearrangement arrays;
    /// [n_models, RELIDAR_DENSIFY_COUNTERS] counters of each model
    Array<std::uint32_t, shared::DensifyCounters> counters;
    Kernel<shared::ObserveParams> observe;
    Kernel<shared::ClassifyParams> classify;
    Kernel<shared::SpawnParams> spawn;
    Kernel<shared::ResetOpacityParams> reset_opacity;
    /// Maximum number of surfels. It is lowered if an allocation fails.
    std::uint32_t memory_limit = std::numeric_limits<std::uint32_t>::max();

    Impl(Device& d, const Scene& scene, const DensifyOptions& o, float alpha_min, std::uint32_t n_frames,
         std::uint64_t random_seed)
        : device(d),
          options(o),
          min_opacity(std::max(float(o.min_opacity), alpha_min)),
          reset_opacity_to(std::max(o.reset_opacity, kResetOverAlphaMin * double(alpha_min))),
          seed(random_seed),
          arrays(d, static_cast<std::uint32_t>(scene.surfels.size()), n_frames, scene.surfels.parameters()),
          counters(d, scene.models.size() * RELIDAR_DENSIFY_COUNTERS, "densification counters"),
          observe(d, "diff/densify/observe"),
          classify(d, "diff/densify/classify"),
          spawn(d, "diff/densify/spawn"),
          reset_opacity(d, "diff/densify/reset_opacity") {
        for (std::size_t model = 0; model < scene.models.size(); ++model)
            extents_m.push_back(compute_model_extent(scene, model));
    }

    std::uint64_t random(Draw draw, int step) const {
        return combine_hashes(combine_hashes(seed, std::uint64_t(draw)), std::uint64_t(step));
    }
    Rules get_densify_rules(int step) const;
    std::vector<ModelCounts> counts(Stream& stream, const DeviceScene& scene, const Rules& rules, int step);
    std::uint32_t reserve_surfels(DeviceScene& scene, Adam& adam, std::uint32_t requested,
                                  double other_allocation_bytes, std::string& why);
    DensifyReport apply(Stream& stream, DeviceScene& scene, Adam& adam, const Rules& rules, int step,
                        double other_allocation_bytes);
};

Rules Densifier::Impl::get_densify_rules(int step) const {
    Rules rules{min_opacity, kUnbounded};
    if (step > options.large_from) rules.max_extent_share = static_cast<float>(options.max_extent_share);
    return rules;
}

std::vector<ModelCounts> Densifier::Impl::counts(Stream& stream, const DeviceScene& scene, const Rules& rules,
                                                 int step) {
    const SurfelStatistics& s = arrays.statistics;
    const std::vector<float> extents(extents_m.begin(), extents_m.end());
    stream.fill(counters);
    relidar::run(stream, classify, scene.size(),
                 {.surfels = get_surfel_pointers(scene.parameters()),
                  .gradient_sum = s.gradient_sum.address(),
                  .n_seen = s.n_seen.address(),
                  .action = arrays.action.address(),
                  .weight = arrays.weight.address(),
                  .counters = counters.address(),
                  .models = scene.models().address(),
                  .extents = stream.impl().values(extents).as<shared::ModelExtents>(),
                  .min_opacity = rules.min_opacity,
                  .max_extent_share = rules.max_extent_share,
                  .clone_extent_share = static_cast<float>(options.clone_extent_share),
                  .gradient_threshold = static_cast<float>(options.gradient_threshold),
                  .n_surfels = scene.size(),
                  .n_models = static_cast<std::uint32_t>(extents.size()),
                  .key = static_cast<std::uint32_t>(random(Draw::classify, step))});
    stream.finish();
    const std::vector<std::uint32_t> values = counters.download();
    std::vector<ModelCounts> result(extents.size());
    for (std::size_t i = 0; i < values.size(); ++i)
        result[i / RELIDAR_DENSIFY_COUNTERS][i % RELIDAR_DENSIFY_COUNTERS] = values[i];
    return result;
}

/// Allocates memory for the surfels after a densification. If memory is short, tries
/// fewer surfels.
/// @param requested desired number of surfels
/// @param why receives the reason if memory is short
/// @return number of surfels for which memory is available, at most `requested`
std::uint32_t Densifier::Impl::reserve_surfels(DeviceScene& scene, Adam& adam, std::uint32_t requested,
                                               double other_allocation_bytes, std::string& why) {
    const std::uint32_t before = scene.size();
    // bytes per surfel of parameters, Adam moments and records
    const double others = 4.0 * (3.0 * count_floats_per_surfel(scene.parameters().parameters()) + 16.0);
    const double bytes = double(arrays.bytes_per_surfel()) + others;
    const auto fits = [&](std::uint32_t target, double capacity) {
        const std::uint32_t now = arrays.capacity();
        const bool grows = capacity > now;
        const double while_copied = grows ? 4.0 * kShFloats * now : 0.0;
        why =
            describe_allocation_failure(device, other_allocation_bytes * target +
                                                    (grows ? bytes * (capacity - now) + while_copied : 0.0));
        if (!why.empty() || !grows) return why.empty();
        try {
            const std::uint32_t n = static_cast<std::uint32_t>(capacity);
            scene.reserve(device, n);
            adam.moment1().reserve(device, n, "first moment");
            adam.moment2().reserve(device, n, "second moment");
            arrays.reserve(n);
        } catch (const OutOfDeviceMemory& error) {
            why = error.what();
        }
        return why.empty();
    };
    for (std::uint32_t growth = requested > before ? requested - before : 0; growth > 0;
         growth = growth >= 16 ? growth / 2 : 0) {
        const std::uint32_t target = before + growth;
        const double generous =
            std::min(1.5 * double(arrays.capacity()),
                     double(std::max(static_cast<std::uint32_t>(options.max_surfels), target)));
        const bool there = target <= arrays.capacity();
        if (fits(target, there ? target : std::max(double(target), generous)) ||
            (!there && fits(target, target)))
            return target;
    }
    return std::min(requested, before);
}

DensifyReport Densifier::Impl::apply(Stream& stream, DeviceScene& scene, Adam& adam, const Rules& rules,
                                     int step, double other_allocation_bytes) {
    const std::uint32_t before = scene.size();
    const std::vector<ModelCounts> counted = counts(stream, scene, rules, step);
    GrowthPlan plan =
        limit_growth_plan(plan_growth(counted, options, random(Draw::phase, step)), memory_limit);
    std::string why;
    const std::uint32_t room = reserve_surfels(scene, adam, plan.size(), other_allocation_bytes, why);
    std::string note;
    if (room < plan.size()) {
        memory_limit = room;
        plan = limit_growth_plan(plan, room);
        note = fmt::format("densification stops at {} surfels: {}", room, why);
    }
    DensifyReport report = make_densify_report(counted, plan);
    report.note = note;
    if (report.removed() == 0 && report.added == 0) {
        arrays.reset_gradient_sums(stream);
        stream.finish();
        return report;
    }
    arrays.assign_new_positions(stream, plan, before);
    arrays.move(stream, scene.parameters(), false, plan.size());
    arrays.move(stream, adam.moment1(), true, plan.size());
    arrays.move(stream, adam.moment2(), true, plan.size());
    relidar::run(stream, spawn, before,
                 {.surfels = get_surfel_pointers(scene.parameters()),
                  .action = arrays.action.address(),
                  .n_rows = arrays.n_rows.address(),
                  .starts = arrays.starts.address(),
                  .n_surfels = before,
                  .key = static_cast<std::uint32_t>(random(Draw::classify, step))});
    arrays.move_statistics(stream);
    stream.finish();
    scene.set_models(plan.ranges(scene.layout().models, counted));
    return report;
}

Densifier::Densifier(Device& device, const Scene& initial, const DensifyOptions& options, float alpha_min,
                     std::uint32_t n_frames, std::uint64_t seed)
    : impl_(options.strategy == DensifyStrategy::none
                ? nullptr
                : std::make_unique<Impl>(device, initial, options, alpha_min, n_frames, seed)) {}
Densifier::~Densifier() = default;
bool Densifier::is_active() const { return impl_ != nullptr; }
SurfelStatistics& Densifier::statistics() { return impl_->arrays.statistics; }
std::vector<double>& Densifier::extents_m() { return impl_->extents_m; }
const std::vector<double>& Densifier::extents_m() const { return impl_->extents_m; }

void Densifier::observe(Stream& stream, const DeviceScene& scene, const ObservedBatch& batch) {
    if (!impl_) return;
    const SurfelStatistics& s = impl_->arrays.statistics;
    RELIDAR_ASSERT_LE(batch.frame / 32 + 1, s.n_words);
    RELIDAR_ASSERT_LE(std::size_t(scene.size()) * s.n_words, s.frames.size());
    relidar::run(stream, impl_->observe, scene.size(),
                 {.d_mean = batch.gradients->mean.address(),
                  .touched = batch.touched->address(),
                  .gradient_sum = s.gradient_sum.address(),
                  .n_seen = s.n_seen.address(),
                  .frames = s.frames.address(),
                  .n_surfels = scene.size(),
                  .n_words = s.n_words,
                  .frame = batch.frame,
                  .is_full_frame = batch.is_full_frame ? 1u : 0u});
}

bool Densifier::should_densify(int step) const {
    if (!impl_) return false;
    const DensifyOptions& o = impl_->options;
    return step >= o.from && step < o.until && step % std::max(1, o.every) == 0;
}

DensifyReport Densifier::run(Stream& stream, DeviceScene& scene, Adam& adam, int step,
                             double other_allocation_bytes) {
    return impl_->apply(stream, scene, adam, impl_->get_densify_rules(step), step, other_allocation_bytes);
}

void Densifier::after_step(Stream& stream, DeviceScene& scene, Adam& adam, int step) {
    if (!impl_) return;
    const DensifyOptions& o = impl_->options;
    if (o.opacity_reset_every <= 0 || step >= o.until || step % o.opacity_reset_every != 0) return;
    relidar::run(stream, impl_->reset_opacity, scene.size(),
                 {.opacity_logit = scene.parameters().opacity_logit.address(),
                  .max_logit = static_cast<float>(logit(impl_->reset_opacity_to)),
                  .n_surfels = scene.size()});
    stream.fill(adam.moment1().opacity_logit);
    stream.fill(adam.moment2().opacity_logit);
}

}  // namespace relidar
