// SPDX-License-Identifier: Apache-2.0
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

/// Tests whether `n_bytes` of device memory are free, by allocating and freeing them.
/// @return an empty string, or the reason why the allocation failed
std::string allocation_error(Device& device, double n_bytes) {
    // Allocates in pieces, because drivers limit the size of one allocation.
    constexpr double kPieceBytes = double(256 << 20), kMinBytes = 4.0;
    std::vector<Buffer> pieces;
    try {
        for (; n_bytes > 0.0; n_bytes -= kPieceBytes)
            pieces.emplace_back(device, std::size_t(std::clamp(n_bytes, kMinBytes, kPieceBytes)),
                                "additional surfels");
    } catch (const OutOfDeviceMemory& error) {
        return error.what();
    }
    return {};
}

struct SurfelAllocation {
    std::uint32_t n_surfels = 0;  ///< number of surfels for which memory is available
    std::string error = {};       ///< the reason if they are fewer than requested
};

/// Purpose of random numbers, a part of their seed, so that the numbers for different
/// purposes are independent. Kernels classify and spawn use different numbers of the
/// log that each surfel has.
enum class RandomPurpose : std::uint64_t { surfels = 1, growth = 2 };

// Opacity of a surfel after an opacity reset, divided by alpha_min (the lowest opacity
// that the renderer blends). Above 1, because invisible surfels get no gradient.
constexpr double kResetOverAlphaMin = 2.5;

}  // namespace

struct Densifier::Impl {
    Device& device;
    DensifyOptions options;
    float min_opacity;
    double reset_opacity_logit;
    std::uint64_t seed = 0;
    std::vector<double> extents_m;
    SurfelReorderer arrays;
    Array<ModelCounters> counters;  ///< [n_models]
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
          reset_opacity_logit(logit(std::max(o.reset_opacity, kResetOverAlphaMin * double(alpha_min)))),
          arrays(d, std::uint32_t(scene.surfels.size()), n_frames, scene.surfels.parameters_used()),
          counters(d, scene.models.size(), "densification counters") {
        for (std::size_t model = 0; model < scene.models.size(); ++model)
            extents_m.push_back(model_extent_m(scene, model));
    }

    static double logit(double probability) { return std::log(probability / (1.0 - probability)); }
    std::uint64_t random_key(RandomPurpose purpose, int step) const {
        return hash_pair(hash_pair(seed, std::uint64_t(purpose)), std::uint64_t(step));
    }
    ModelCounts choose_actions(Stream& stream, const DeviceScene& scene, int step);
    SurfelAllocation allocate_surfels(DeviceScene& scene, Adam& adam, std::uint32_t n_requested,
                                      double reserved_bytes_per_surfel);
    double count_growth_bytes(const DeviceScene& scene, std::uint32_t capacity) const;
    std::string try_reserve(DeviceScene& scene, Adam& adam, std::uint32_t capacity, double reserved_bytes);
    void rearrange_surfels(Stream& stream, DeviceScene& scene, Adam& adam, int step, const GrowthPlan& plan);
};

/// Runs the kernel that chooses an action for each surfel: keep, clone (add a copy),
/// split (replace by two smaller ones) or drop (faint, large, invalid or outside its
/// actor's box). Surfels with a large mean gradient grow: small ones are cloned, large
/// ones split. Waits for it and returns how many surfels of each model got each action.
ModelCounts Densifier::Impl::choose_actions(Stream& stream, const DeviceScene& scene, int step) {
    const SurfelStatistics& statistics = arrays.statistics;
    // A surfel is large if its standard deviation exceeds a share of its model's extent.
    // Up to step `large_from`, no surfel is dropped because of its size.
    const std::vector<float> model_extents(extents_m.begin(), extents_m.end());
    const float max_extent_share =
        step > options.large_from ? float(options.max_extent_share) : std::numeric_limits<float>::infinity();
    stream.fill(counters);
    relidar::run(stream, classify, scene.size(),
                 {.surfels = surfel_pointers(scene.surfel_parameters()),
                  .gradient_sum = statistics.gradient_sum.address(),
                  .n_seen = statistics.n_observing_batches.address(),
                  .action = arrays.action.address(),
                  .weight = arrays.weight.address(),
                  .counters = counters.address_as<std::uint32_t, shared::DensifyCounters>(),
                  .models = scene.model_table().address(),
                  .extents = stream.impl().stage_values(model_extents).cast_tag<shared::ModelExtents>(),
                  .min_opacity = min_opacity,
                  .max_extent_share = max_extent_share,
                  .clone_extent_share = float(options.clone_extent_share),
                  .gradient_threshold = float(options.gradient_threshold),
                  .n_surfels = scene.size(),
                  .n_models = std::uint32_t(model_extents.size()),
                  .key = std::uint32_t(random_key(RandomPurpose::surfels, step))});
    stream.submit_and_wait();
    return counters.download();
}

/// Returns the memory for a growth to `capacity` surfels, including temporary copies.
double Densifier::Impl::count_growth_bytes(const DeviceScene& scene, std::uint32_t capacity) const {
    const std::uint32_t old_capacity = arrays.capacity();
    if (capacity <= old_capacity) return 0.0;
    constexpr double kFloatBytes = 4.0, kFloatsPerRecord = 16.0;
    // A surfel has its parameters, two Adam moments of each, and a record for kernels.
    const double scene_floats =
        3.0 * floats_per_surfel(scene.surfel_parameters().parameters_used()) + kFloatsPerRecord;
    const double bytes_per_surfel = double(arrays.bytes_per_surfel()) + kFloatBytes * scene_floats;
    // Arrays are copied one by one, so only one old array, at most the SH coefficients,
    // exists next to its copy.
    return bytes_per_surfel * (capacity - old_capacity) + kFloatBytes * kShFloats * old_capacity;
}

/// Allocates memory for `capacity` surfels, if `reserved_bytes` of device memory stay
/// free. After an error, some arrays may be larger than before, with the same content.
/// @return an empty string, or the reason why there is not enough memory
std::string Densifier::Impl::try_reserve(DeviceScene& scene, Adam& adam, std::uint32_t capacity,
                                         double reserved_bytes) {
    const std::string error = allocation_error(device, reserved_bytes + count_growth_bytes(scene, capacity));
    if (!error.empty() || capacity <= arrays.capacity()) return error;
    try {
        scene.reserve(device, capacity);
        adam.first_moments().reserve(device, capacity, "first moment");
        adam.second_moments().reserve(device, capacity, "second moment");
        arrays.reserve_surfels(capacity);
    } catch (const OutOfDeviceMemory& out_of_memory) {
        return out_of_memory.what();
    }
    return {};
}

/// Allocates memory for the surfels after a densification. If there is not enough memory,
/// halves the growth until it fits.
/// @param reserved_bytes_per_surfel memory that must stay free for other objects
SurfelAllocation Densifier::Impl::allocate_surfels(DeviceScene& scene, Adam& adam, std::uint32_t n_requested,
                                                   double reserved_bytes_per_surfel) {
    constexpr std::uint32_t kMinHalvedGrowth = 16;  // gives up instead of halving a smaller growth
    const std::uint32_t n_before = scene.size();
    std::string error;
    std::uint32_t growth = n_requested > n_before ? n_requested - n_before : 0;
    while (growth > 0) {
        const std::uint32_t target = n_before + growth;
        const double reserved_bytes = reserved_bytes_per_surfel * target;
        if (target > arrays.capacity()) {
            // Tries up to 1.5 times the present memory first, so that the next
            // densifications need no allocation.
            const std::uint32_t max_surfels = std::max(std::uint32_t(options.max_surfels), target);
            const auto generous = std::uint32_t(std::min(1.5 * arrays.capacity(), double(max_surfels)));
            error = try_reserve(scene, adam, std::max(target, generous), reserved_bytes);
            if (error.empty()) return {target};
        }
        error = try_reserve(scene, adam, target, reserved_bytes);
        if (error.empty()) return {target};
        growth = growth >= kMinHalvedGrowth ? growth / 2 : 0;
    }
    return {std::min(n_requested, n_before), error};  // the scene does not grow
}

/// Moves the surfels, their Adam moments and statistics to the new order, and computes
/// the values of new surfels.
void Densifier::Impl::rearrange_surfels(Stream& stream, DeviceScene& scene, Adam& adam, int step,
                                        const GrowthPlan& plan) {
    const std::uint32_t n_before = scene.size();
    arrays.compute_indices(stream, plan, n_before);
    arrays.move_surfels(stream, scene.surfel_parameters(), NewRows::copy, plan.size());
    arrays.move_surfels(stream, adam.first_moments(), NewRows::zero, plan.size());
    arrays.move_surfels(stream, adam.second_moments(), NewRows::zero, plan.size());
    // Moves both halves of a split surfel to random points in it, and makes them smaller.
    relidar::run(stream, spawn, n_before,
                 {.surfels = surfel_pointers(scene.surfel_parameters()),
                  .action = arrays.action.address(),
                  .n_rows = arrays.n_rows.address(),
                  .starts = arrays.starts.address(),
                  .n_surfels = n_before,
                  .key = std::uint32_t(random_key(RandomPurpose::surfels, step))});
    arrays.move_statistics(stream);
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

/// Adds and removes surfels. First counts the surfels to add and to remove, because the
/// host must allocate the arrays before their rows can move.
DensifyReport Densifier::densify_surfels(Stream& stream, DeviceScene& scene, Adam& adam, int step,
                                         double reserved_bytes_per_surfel) {
    Impl& d = *impl_;
    const ModelCounts counts = d.choose_actions(stream, scene, step);
    // The random number selects the surfels that get copies if not all can.
    GrowthPlan plan = plan_growth(counts, d.options, d.random_key(RandomPurpose::growth, step));
    plan = limit_growth(plan, d.memory_limit);  // of an earlier step
    const auto [n_possible, error] = d.allocate_surfels(scene, adam, plan.size(), reserved_bytes_per_surfel);
    std::string note;
    if (n_possible < plan.size()) {
        d.memory_limit = n_possible;
        plan = limit_growth(plan, n_possible);
        note = fmt::format("training stops adding surfels at {} surfels: {}", n_possible, error);
    }
    DensifyReport report = densify_report(counts, plan);
    report.note = note;
    if (report.n_removed() == 0 && report.added == 0) {
        d.arrays.reset_sums(stream);  // as rearrange_surfels() does
        stream.submit_and_wait();
        return report;
    }
    d.rearrange_surfels(stream, scene, adam, step, plan);
    stream.submit_and_wait();
    scene.set_models(plan.assign_ranges(scene.layout().models, counts));
    return report;
}

/// Lowers all opacities to a small value at regular steps. Surfels that are needed become
/// opaque again, and the others are removed later as too faint. Also resets the Adam
/// moments of the opacities, because old moments would restore the old values.
void Densifier::reset_opacities(Stream& stream, DeviceScene& scene, Adam& adam, int step) {
    if (!impl_) return;
    const DensifyOptions& o = impl_->options;
    if (o.opacity_reset_every <= 0 || step >= o.until || step % o.opacity_reset_every != 0) return;
    relidar::run(stream, impl_->reset_opacity, scene.size(),
                 {.opacity_logit = scene.surfel_parameters().opacity_logit.address(),
                  .max_logit = float(impl_->reset_opacity_logit),
                  .n_surfels = scene.size()});
    stream.fill(adam.first_moments().opacity_logit);
    stream.fill(adam.second_moments().opacity_logit);
}

}  // namespace relidar
