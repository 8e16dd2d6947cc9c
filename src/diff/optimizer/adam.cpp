// SPDX-License-Identifier: Apache-2.0
#include <relidar/diff/optimizer.hpp>

#include <algorithm>
#include <cmath>
#include <optional>

#include <relidar/scene/device_scene.hpp>

#include "base/assert.hpp"
#include "diff/shared/optimizer.h"
#include "gpu/stream.hpp"

namespace relidar {

double interpolate_exp(double start, double end, int step, int n_steps) {
    const double s = n_steps > 0 ? std::clamp(double(step) / n_steps, 0.0, 1.0) : 1.0;
    return std::exp((1.0 - s) * std::log(start) + s * std::log(end));
}

namespace {

using enum SpecialisationConstantId;

// Number of threads per workgroup. With only 32 threads, a GPU would not be fully
// occupied.
constexpr std::uint32_t kStreamingThreads = 128;

std::vector<SpecialisationConstant> adam_constants(bool thread_per_float) {
    return {{ONE_THREAD_PER_FLOAT, thread_per_float ? 1u : 0u}, {WORKGROUP_SIZE, kStreamingThreads}};
}

/// Returns the factor that removes the bias of a moment, which starts at 0.
float moment_correction(double beta, int step_number) {
    return float(1.0 / (1.0 - std::pow(beta, step_number)));
}

/// Returns kernel parameters with the constants of Adam for one step. The factors on the
/// learning rate for the start of a row are 1. All other parameters are 0.
shared::AdamParams make_adam_params(const AdamOptions& options, int step_number) {
    shared::AdamParams params{};
    params.beta1 = float(options.beta1);
    params.beta2 = float(options.beta2);
    params.epsilon = float(options.epsilon);
    params.correction1 = moment_correction(options.beta1, step_number);
    params.correction2 = moment_correction(options.beta2, step_number);
    params.first_value_factor = params.first_block_factor = 1.0f;
    return params;
}

/// Sets the parts of a surfel's row in a parameter group. The row of spherical harmonics,
/// [channels, coefficients], has a block per channel. Every other row is one block.
/// @param sh_degree highest degree of harmonics that is updated. It grows during training
void set_row_layout(shared::AdamParams& params, const SurfelParameterGroup& group, int sh_degree) {
    params.stride = group.count_floats();
    params.block = group.harmonics ? group.row[1] : params.stride;
    params.n_blocks = params.stride / params.block;
    params.n_active = group.harmonics ? std::uint32_t((sh_degree + 1) * (sh_degree + 1)) : params.block;
}

}  // namespace

struct Adam::Impl {
    Device& device;
    AdamOptions options;
    SurfelArrays moment1, moment2;
    bool thread_per_float = should_coalesce(device);
    Array<float, shared::ScaleBounds> max_log_scale{device, 0, "bounds of scales"};
    Kernel<shared::AdamParams> kernel{device, "diff/optimizer/adam", adam_constants(thread_per_float)};
    std::vector<float> logit_factors = {};       ///< [models] or empty
    std::optional<TouchedSurfelList> list = {};  ///< set with AdamOptions::only_touched

    void set_rates(shared::AdamParams& params, const SurfelParameterGroup& group, const LearningRates& rates,
                   Stream& stream) const;
    void select_rows(shared::AdamParams& params, Stream& stream,
                     Address<std::uint32_t, shared::TouchedSurfels> flags);
};

/// Sets the learning rate of a parameter group, and factors with which the kernel changes
/// it for parts of a row and for single models. Only means and harmonics have them.
void Adam::Impl::set_rates(shared::AdamParams& params, const SurfelParameterGroup& group,
                           const LearningRates& rates, Stream& stream) const {
    double rate = rates.*group.rate;
    const std::vector<float>* model_factors = nullptr;
    if (group.rate == &LearningRates::mean) model_factors = &rates.mean_factors;
    if (group.harmonics) {
        // A row has one block per channel: intensity, hit logit, drop logit. The rate is
        // reduced. The factor of a block's first value (constant harmonic) undoes that.
        rate *= rates.sh_rest_factor;
        params.first_value_factor = float(1.0 / std::max(rates.sh_rest_factor, 1e-12));
        params.first_block_factor = float(rates.intensity_factor);
        params.first_model_block = 1;  // after the intensity: the factors are for logits
        model_factors = &logit_factors;
    }
    params.learning_rate = float(rate);
    if (!model_factors || model_factors->empty()) return;
    params.model_factors = stream.impl().stage_values(*model_factors).cast_tag<shared::ModelRates>();
    params.models = rates.models->address();
    params.n_models = std::uint32_t(model_factors->size());
}

/// Allocates the moments of all surfels except the fixed ones, which are not updated, and
/// sets them to zero.
Adam::Adam(Device& device, std::uint32_t n_surfels, const AdamOptions& options, SurfelParameterSet used) {
    const std::uint32_t n_updated = n_surfels - std::min(options.n_fixed, n_surfels);
    impl_.reset(new Impl{device,
                         options,
                         {device, n_updated, "first moment", used},
                         {device, n_updated, "second moment", used}});
    if (options.only_touched) impl_->list.emplace(device);
    Stream stream(device);
    impl_->moment1.fill_zero(stream);
    impl_->moment2.fill_zero(stream);
    // A resumed run uploads the moments of its checkpoint after this constructor. Waits
    // here, so that the zero fill cannot overwrite the uploaded moments.
    stream.submit_and_wait();
}

Adam::~Adam() = default;
SurfelArrays& Adam::first_moments() { return impl_->moment1; }
SurfelArrays& Adam::second_moments() { return impl_->moment2; }
Array<float>& Adam::max_log_scales() { return impl_->max_log_scale; }

void Adam::set_max_log_scales(Device& device, const std::vector<float>& max_log_scales) {
    impl_->max_log_scale = {device, max_log_scales, "bounds of scales"};
}

void Adam::set_logit_factors(std::vector<float> factors) { impl_->logit_factors = std::move(factors); }

/// Selects the surfels that have a gradient. With `list`, the kernel updates only these
/// surfels. Without it, the other surfels get an update with a gradient of zero.
/// @param flags [params.n_rows] 1 for a surfel with a gradient
void Adam::Impl::select_rows(shared::AdamParams& params, Stream& stream,
                             Address<std::uint32_t, shared::TouchedSurfels> flags) {
    if (!list) {
        params.touched = flags;
        return;
    }
    list->compact(stream, flags, params.n_rows);
    params.rows = list->rows_address();
    params.n_listed = list->count_address();
}

/// Records one Adam step for all groups of surfel parameters. Does not update the fixed
/// surfels, which are the first in the arrays.
void Adam::record_step(Stream& stream, SurfelArrays& parameters, const SurfelArrays& gradients,
                       const Array<std::uint32_t, shared::TouchedSurfels>* touched_flags,
                       const LearningRates& learning_rates, int step_number, int sh_degree) {
    Impl& adam = *impl_;
    const std::uint32_t first = std::min(adam.options.n_fixed, parameters.n), n_rows = parameters.n - first;
    RELIDAR_ASSERT_LE(n_rows, adam.moment1.n);
    RELIDAR_ASSERT_LE(parameters.n, gradients.n);
    RELIDAR_ASSERT_EQ(adam.max_log_scale.size() == 0 || adam.max_log_scale.size() == parameters.n, true);
    shared::AdamParams all_groups = make_adam_params(adam.options, step_number);
    all_groups.first_row = first;
    all_groups.n_rows = n_rows;
    if (touched_flags) adam.select_rows(all_groups, stream, touched_flags->address(first));
    const bool uses_list = adam.list && touched_flags;
    const ConcurrentLaunchScope groups(stream);  // launches may overlap, because the groups are independent
    for (const SurfelParameterGroup& group : list_groups(parameters.parameters_used())) {
        shared::AdamParams params = all_groups;
        set_row_layout(params, group, sh_degree);
        adam.set_rates(params, group, learning_rates, stream);
        // The moments have no rows for the fixed surfels at the start.
        const std::size_t first_float = std::size_t(first) * params.stride;
        params.values = group.device(parameters).address_as<float, shared::AdamValues>(first_float);
        params.gradients = group.device(gradients).address_as<float, shared::AdamGradients>(first_float);
        params.moment1 = group.device(adam.moment1).address_as<float, shared::FirstMoments>();
        params.moment2 = group.device(adam.moment2).address_as<float, shared::SecondMoments>();
        if (group.scales && adam.max_log_scale.size() > 0) params.bounds = adam.max_log_scale.address(first);
        const std::size_t threads_per_row = adam.thread_per_float ? params.n_blocks * params.n_active : 1;
        const std::size_t n_threads = n_rows * threads_per_row;
        // The host does not know the length of the list, so its threads are limited.
        run(stream, adam.kernel, uses_list ? adam.list->choose_threads(n_threads) : n_threads, params);
    }
}

struct ArrayAdam::Impl {
    Device& device;
    AdamOptions options;
    std::size_t count;
    Array<float, shared::FirstMoments> moment1{device, count, "first moment"};
    Array<float, shared::SecondMoments> moment2{device, count, "second moment"};
    Kernel<shared::AdamParams> kernel{device, "diff/optimizer/adam", adam_constants(true)};
};

ArrayAdam::ArrayAdam(Device& device, std::size_t count, const AdamOptions& options) {
    impl_.reset(new Impl{device, options, count});
    Stream stream(device);
    stream.fill(impl_->moment1);
    stream.fill(impl_->moment2);
    stream.submit_and_wait();
}
ArrayAdam::~ArrayAdam() = default;
Array<float>& ArrayAdam::first_moments() { return impl_->moment1; }
Array<float>& ArrayAdam::second_moments() { return impl_->moment2; }

void ArrayAdam::record_step(Stream& stream, const Array<float>& values, const Array<float>& gradients,
                            double learning_rate, int step_number) {
    Impl& a = *impl_;
    RELIDAR_ASSERT_LE(a.moment1.size(), values.size());
    RELIDAR_ASSERT_LE(a.moment1.size(), gradients.size());
    shared::AdamParams params = make_adam_params(a.options, step_number);
    params.values = values.address_as<float, shared::AdamValues>();
    params.gradients = gradients.address_as<float, shared::AdamGradients>();
    params.moment1 = a.moment1.address();
    params.moment2 = a.moment2.address();
    params.learning_rate = float(learning_rate);
    params.n_rows = std::uint32_t(a.moment1.size());
    params.stride = params.block = params.n_blocks = params.n_active = 1;
    run(stream, a.kernel, a.moment1.size(), params);
}

}  // namespace relidar
