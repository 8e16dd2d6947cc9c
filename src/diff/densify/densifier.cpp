// SPDX-License-Identifier: Apache-2.0
// Host side of densification, which adds and removes surfels. Chooses an action for each
// surfel, reads the counts, allocates memory, distributes copies, moves every array, and
// computes the values of new surfels.
#include <relidar/diff/densify.hpp>

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include <relidar/diff/optimizer.hpp>
#include <relidar/gpu/out_of_memory.hpp>

#include "base/assert.hpp"
#include "base/random.hpp"
#include "diff/densify/rearrange.hpp"
#include "gpu/stream.hpp"

namespace relidar {

namespace {

/// Tests whether `n_bytes` of device memory are available, by allocating and freeing
/// them.
/// @return an empty string, or the reason why the allocation failed
std::string allocation_error(Device& device, double n_bytes) {
    // allocates in pieces, because drivers limit the size of one allocation
    constexpr double kPiece = double(256 << 20);
    std::vector<Buffer> pieces;
    try {
        for (; n_bytes > 0.0; n_bytes -= kPiece)
            pieces.emplace_back(device, std::size_t(std::min(std::max(n_bytes, 4.0), kPiece)),
                                "additional surfels");
    } catch (const OutOfDeviceMemory& error) {
        return error.what();
    }
    return {};
}

double logit(double probability) { return std::log(probability / (1.0 - probability)); }

/// Purpose of random numbers. It is part of the seed, so that random numbers for
/// different purposes are independent.
enum class RandomPurpose : std::uint64_t { classify = 1, phase = 2 };

// Opacity of a surfel after an opacity reset, divided by alpha_min (the lowest opacity
// that the renderer blends). Above 1, because invisible surfels get no gradient.
constexpr double kResetOverAlphaMin = 2.5;

}  // namespace

struct Densifier::Impl {
    Device& device;
    DensifyOptions options;
    float min_opacity;
    double reset_opacity_to;
    std::uint64_t seed = 0;
    std::vector<double> extents_m;
    SurfelReorderer arrays;
    /// [n_models, RELIDAR_DENSIFY_COUNTERS] counters of each model
    Array<std::uint32_t, shared::DensifyCounters> counters;
    Kernel<shared::ObserveParams> observe{device, "diff/densify/observe"};
    Kernel<shared::ClassifyParams> classify{device, "diff/densify/classify"};
    Kernel<shared::SpawnParams> spawn{device, "diff/densify/spawn"};
    Kernel<shared::ResetOpacityParams> reset_opacity{device, "diff/densify/reset_opacity"};
    /// Maximum number of surfels. Becomes smaller if an allocation fails.
    std::uint32_t memory_limit = std::numeric_limits<std::uint32_t>::max();

    Impl(Device& d, const Scene& scene, const DensifyOptions& o, float alpha_min, std::uint32_t n_frames)
        : device(d),
          options(o),
          min_opacity(std::max(float(o.min_opacity), alpha_min)),
          reset_opacity_to(std::max(o.reset_opacity, kResetOverAlphaMin * double(alpha_min))),
          arrays(d, std::uint32_t(scene.surfels.size()), n_frames, scene.surfels.parameters_used()),
          counters(d, scene.models.size() * RELIDAR_DENSIFY_COUNTERS, "densification counters") {
        for (std::size_t model = 0; model < scene.models.size(); ++model)
            extents_m.push_back(model_extent_m(scene, model));
    }

    std::uint64_t random_key(RandomPurpose purpose, int step) const {
        return hash_pair(hash_pair(seed, std::uint64_t(purpose)), std::uint64_t(step));
    }
    ModelCounts choose_actions(Stream& stream, const DeviceScene& scene, int step);
    std::uint32_t allocate_surfels(DeviceScene& scene, Adam& adam, std::uint32_t n_requested,
                                   double reserved_bytes_per_surfel, std::string& error);
};

/// Runs the kernel that chooses an action for each surfel (keep, clone, split, drop).
/// Waits for it and returns its counters for each model.
ModelCounts Densifier::Impl::choose_actions(Stream& stream, const DeviceScene& scene, int step) {
    const SurfelStatistics& s = arrays.statistics;
    const std::vector<float> extents(extents_m.begin(), extents_m.end());
    stream.fill(counters);
    relidar::run(stream, classify, scene.size(),
                 {.surfels = surfel_pointers(scene.surfel_parameters()),
                  .gradient_sum = s.gradient_sum.address(),
                  .n_seen = s.n_observing_batches.address(),
                  .action = arrays.action.address(),
                  .weight = arrays.weight.address(),
                  .counters = counters.address(),
                  .models = scene.model_table().address(),
                  .extents = stream.impl().stage_values(extents).cast_tag<shared::ModelExtents>(),
                  .min_opacity = min_opacity,
                  .max_extent_share = step > options.large_from ? float(options.max_extent_share)
                                                                : std::numeric_limits<float>::infinity(),
                  .clone_extent_share = float(options.clone_extent_share),
                  .gradient_threshold = float(options.gradient_threshold),
                  .n_surfels = scene.size(),
                  .n_models = std::uint32_t(extents.size()),
                  .key = std::uint32_t(random_key(RandomPurpose::classify, step))});
    stream.submit_and_wait();
    const std::vector<std::uint32_t> values = counters.download();
    ModelCounts result(extents.size());
    for (std::size_t i = 0; i < values.size(); ++i)
        result[i / RELIDAR_DENSIFY_COUNTERS][i % RELIDAR_DENSIFY_COUNTERS] = values[i];
    return result;
}

/// Allocates memory for the surfels after a densification. If there is not enough memory,
/// tries fewer surfels.
/// @param error receives the reason if there is not enough memory
/// @return number of surfels for which memory is available, at most `n_requested`
std::uint32_t Densifier::Impl::allocate_surfels(DeviceScene& scene, Adam& adam, std::uint32_t n_requested,
                                                double reserved_bytes_per_surfel, std::string& error) {
    const std::uint32_t before = scene.size();
    // bytes per surfel for parameters, Adam moments and records
    const double others = 4.0 * (3.0 * floats_per_surfel(scene.surfel_parameters().parameters_used()) + 16.0);
    const double bytes = double(arrays.bytes_per_surfel()) + others;
    const auto fits = [&](std::uint32_t target, double capacity) {
        const std::uint32_t now = arrays.capacity();
        const bool grows = capacity > now;
        // Old and new SH coefficients, the largest array, exist at the same time during
        // the copy.
        const double while_copied = grows ? 4.0 * kShFloats * now : 0.0;
        error = allocation_error(device, reserved_bytes_per_surfel * target +
                                             (grows ? bytes * (capacity - now) + while_copied : 0.0));
        if (!error.empty() || !grows) return error.empty();
        try {
            const std::uint32_t n = std::uint32_t(capacity);
            scene.reserve(device, n);
            adam.first_moments().reserve(device, n, "first moment");
            adam.second_moments().reserve(device, n, "second moment");
            arrays.reserve_surfels(n);
        } catch (const OutOfDeviceMemory& e) {
            error = e.what();
        }
        return error.empty();
    };
    // Halves the growth until it fits. Gives up below 16 new surfels.
    for (std::uint32_t growth = n_requested > before ? n_requested - before : 0; growth > 0;
         growth = growth >= 16 ? growth / 2 : 0) {
        const std::uint32_t target = before + growth;
        // Allocates up to 1.5 times the memory, so that the next densifications need no
        // allocation. If this fails, tries the exact size.
        const double generous = std::min(1.5 * double(arrays.capacity()),
                                         double(std::max(std::uint32_t(options.max_surfels), target)));
        const bool there = target <= arrays.capacity();
        if (fits(target, there ? target : std::max(double(target), generous)) ||
            (!there && fits(target, target)))
            return target;
    }
    return std::min(n_requested, before);
}

Densifier::Densifier(Device& device, const Scene& initial, const DensifyOptions& options, float alpha_min,
                     std::uint32_t n_frames, std::uint64_t seed) {
    if (options.strategy == DensifyStrategy::none) return;
    impl_ = std::make_unique<Impl>(device, initial, options, alpha_min, n_frames);
    impl_->seed = seed;
}
Densifier::~Densifier() = default;
bool Densifier::is_enabled() const { return impl_ != nullptr; }
SurfelStatistics& Densifier::statistics() { return impl_->arrays.statistics; }
std::vector<double>& Densifier::model_extents_m() { return impl_->extents_m; }
const std::vector<double>& Densifier::model_extents_m() const { return impl_->extents_m; }

void Densifier::record_statistics(Stream& stream, const DeviceScene& scene, const BackpropagatedBatch& b) {
    if (!impl_) return;
    const SurfelStatistics& s = impl_->arrays.statistics;
    RELIDAR_ASSERT_LE(b.frame / 32 + 1, s.n_words);
    RELIDAR_ASSERT_LE(std::size_t(scene.size()) * s.n_words, s.frames.size());
    relidar::run(stream, impl_->observe, scene.size(),
                 {.d_mean = b.gradients->mean.address(),
                  .touched = b.touched->address(),
                  .gradient_sum = s.gradient_sum.address(),
                  .n_seen = s.n_observing_batches.address(),
                  .frames = s.frames.address(),
                  .n_surfels = scene.size(),
                  .n_words = s.n_words,
                  .frame = b.frame,
                  .is_full_frame = b.is_full_frame ? 1u : 0u});
}

bool Densifier::is_densify_step(int step) const {
    if (!impl_) return false;
    const DensifyOptions& o = impl_->options;
    return step >= o.from && step < o.until && step % std::max(1, o.every) == 0;
}

/// Adds and removes surfels. Counts first, because the host must know the new number of
/// surfels before it allocates memory and moves the arrays.
DensifyReport Densifier::densify_surfels(Stream& stream, DeviceScene& scene, Adam& adam, int step,
                                         double reserved_bytes_per_surfel) {
    Impl& d = *impl_;
    const std::uint32_t before = scene.size();
    const ModelCounts counted = d.choose_actions(stream, scene, step);
    GrowthPlan plan = limit_growth(plan_growth(counted, d.options, d.random_key(RandomPurpose::phase, step)),
                                   d.memory_limit);
    std::string error;
    const std::uint32_t surfel_capacity =
        d.allocate_surfels(scene, adam, plan.size(), reserved_bytes_per_surfel, error);
    std::string note;
    if (surfel_capacity < plan.size()) {
        // Remembers the limit, so that later steps do not try again.
        d.memory_limit = surfel_capacity;
        plan = limit_growth(plan, surfel_capacity);
        note = fmt::format("training stops adding surfels at {} surfels: {}", surfel_capacity, error);
    }
    DensifyReport report = densify_report(counted, plan);
    report.note = note;
    if (report.n_removed() == 0 && report.added == 0) {
        d.arrays.reset_sums(stream);
        stream.submit_and_wait();
        return report;
    }
    d.arrays.compute_indices(stream, plan, before);
    d.arrays.move_surfels(stream, scene.surfel_parameters(), false, plan.size());
    d.arrays.move_surfels(stream, adam.first_moments(), true, plan.size());
    d.arrays.move_surfels(stream, adam.second_moments(), true, plan.size());
    // After the move, both halves of a split still have the values of the original.
    relidar::run(stream, d.spawn, before,
                 {.surfels = surfel_pointers(scene.surfel_parameters()),
                  .action = d.arrays.action.address(),
                  .n_rows = d.arrays.n_rows.address(),
                  .starts = d.arrays.starts.address(),
                  .n_surfels = before,
                  .key = std::uint32_t(d.random_key(RandomPurpose::classify, step))});
    d.arrays.move_statistics(stream);
    stream.submit_and_wait();
    scene.set_models(plan.assign_ranges(scene.layout().models, counted));
    return report;
}

/// Lowers all opacities to a small value at regular steps. Surfels that are needed become
/// opaque again, and the others are removed later as too faint.
void Densifier::reset_opacities(Stream& stream, DeviceScene& scene, Adam& adam, int step) {
    if (!impl_) return;
    const DensifyOptions& o = impl_->options;
    if (o.opacity_reset_every <= 0 || step >= o.until || step % o.opacity_reset_every != 0) return;
    relidar::run(stream, impl_->reset_opacity, scene.size(),
                 {.opacity_logit = scene.surfel_parameters().opacity_logit.address(),
                  .max_logit = float(logit(impl_->reset_opacity_to)),
                  .n_surfels = scene.size()});
    stream.fill(adam.first_moments().opacity_logit);
    stream.fill(adam.second_moments().opacity_logit);
}

}  // namespace relidar
