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

float moment_correction(double beta, int step_number) {
    return float(1.0 / (1.0 - std::pow(beta, step_number)));
}

}  // namespace

struct Adam::Impl {
    Device& device;
    AdamOptions options;
    SurfelArrays moment1, moment2;
    bool per_float = should_coalesce(device);
    Array<float, shared::ScaleBounds> max_log_scale{device, 0, "bounds of scales"};
    Kernel<shared::AdamParams> kernel{device, "diff/optimizer/adam", adam_constants(per_float)};
    std::vector<float> logit_factors = {};       ///< [models] or empty
    std::optional<TouchedSurfelList> list = {};  ///< set if only the rows that have a gradient are updated
};

Adam::Adam(Device& device, std::uint32_t n_surfels, const AdamOptions& options, SurfelParameterSet used) {
    const std::uint32_t n = n_surfels - std::min(options.n_fixed, n_surfels);
    impl_.reset(
        new Impl{device, options, {device, n, "first moment", used}, {device, n, "second moment", used}});
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

/// Records one Adam step for all groups of surfel parameters. Skips the fixed surfels at
/// the start of the arrays and, if `touched_flags` is set, surfels without a gradient.
void Adam::record_step(Stream& stream, SurfelArrays& parameters, const SurfelArrays& gradients,
                       const Array<std::uint32_t, shared::TouchedSurfels>* touched_flags,
                       const LearningRates& learning_rates, int step_number, int sh_degree) {
    Impl& a = *impl_;
    const std::uint32_t first = std::min(a.options.n_fixed, parameters.n), n_rows = parameters.n - first;
    RELIDAR_ASSERT_LE(n_rows, a.moment1.n);
    RELIDAR_ASSERT_LE(parameters.n, gradients.n);
    RELIDAR_ASSERT_EQ(a.max_log_scale.size() == 0 || a.max_log_scale.size() == parameters.n, true);
    const bool listed = a.list && touched_flags;
    if (listed) a.list->compact(stream, touched_flags->address(first), n_rows);
    // Only harmonics up to the current degree are updated. The degree grows during
    // training.
    const std::uint32_t active_harmonics = std::uint32_t((sh_degree + 1) * (sh_degree + 1));
    const ConcurrentLaunchScope groups(stream);  // launches may overlap, because the groups are independent
    for (const SurfelParameterGroup& group : list_groups(parameters.parameters_used())) {
        const std::uint32_t stride = group.count_floats(), block = group.harmonics ? group.row[1] : stride;
        const std::uint32_t n_active = group.harmonics ? active_harmonics : block, n_blocks = stride / block;
        // All spherical harmonics except the constant one have a lower learning rate.
        const double rest_factor = group.harmonics ? learning_rates.sh_rest_factor : 1.0;
        const std::size_t from = std::size_t(first) * stride;
        // Factors of the models. In the group of SH, they apply to all channels but the
        // first: the logits.
        const std::vector<float> none, &factors = group.harmonics ? a.logit_factors
                                                  : group.rate == &LearningRates::mean
                                                      ? learning_rates.mean_factors
                                                      : none;
        const bool by_model = !factors.empty();
        const std::size_t n_threads = std::size_t(n_rows) * (a.per_float ? n_blocks * n_active : 1u);
        run(stream, a.kernel, listed ? a.list->choose_threads(n_threads) : n_threads,
            {.values = group.device(parameters).address_as<float, shared::AdamValues>(from),
             .gradients = group.device(gradients).address_as<float, shared::AdamGradients>(from),
             .moment1 = group.device(a.moment1).address_as<float, shared::FirstMoments>(),
             .moment2 = group.device(a.moment2).address_as<float, shared::SecondMoments>(),
             .touched = touched_flags && !listed ? touched_flags->address(first)
                                                 : Address<std::uint32_t, shared::TouchedSurfels>{},
             .rows = listed ? a.list->rows_address() : Address<std::uint32_t, shared::TouchedRows>{},
             .n_listed = listed ? a.list->count_address() : Address<std::uint32_t, shared::TouchedCount>{},
             .bounds = group.scales && a.max_log_scale.size() > 0 ? a.max_log_scale.address(first)
                                                                  : Address<float, shared::ScaleBounds>{},
             .model_scale = (by_model ? stream.impl().stage_values(factors) : Address<float>{})
                                .cast_tag<shared::ModelRates>(),
             .models = by_model ? learning_rates.models->address() : Address<shared::ModelEntry>{},
             .learning_rate = float(learning_rates.*group.rate * rest_factor),
             .beta1 = float(a.options.beta1),
             .beta2 = float(a.options.beta2),
             .epsilon = float(a.options.epsilon),
             .correction1 = moment_correction(a.options.beta1, step_number),
             .correction2 = moment_correction(a.options.beta2, step_number),
             .first_scale = float(1.0 / std::max(rest_factor, 1e-12)),
             .block_scale = float(group.harmonics ? learning_rates.intensity_factor : 1.0),
             .n_models = std::uint32_t(factors.size()),
             .first_scaled_block = group.harmonics ? 1u : 0u,
             .first_row = first,
             .n_rows = n_rows,
             .stride = stride,
             .block = block,
             .n_blocks = n_blocks,
             .n_active = n_active});
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
    shared::AdamParams params{};
    params.values = values.address_as<float, shared::AdamValues>();
    params.gradients = gradients.address_as<float, shared::AdamGradients>();
    params.moment1 = a.moment1.address();
    params.moment2 = a.moment2.address();
    params.learning_rate = float(learning_rate);
    params.beta1 = float(a.options.beta1);
    params.beta2 = float(a.options.beta2);
    params.epsilon = float(a.options.epsilon);
    params.correction1 = moment_correction(a.options.beta1, step_number);
    params.correction2 = moment_correction(a.options.beta2, step_number);
    // Each row has one value, so it has no blocks with different learning rates.
    params.first_scale = params.block_scale = 1.0f;
    params.n_rows = std::uint32_t(a.moment1.size());
    params.stride = params.block = params.n_blocks = params.n_active = 1;
    run(stream, a.kernel, a.moment1.size(), params);
}

}  // namespace relidar
