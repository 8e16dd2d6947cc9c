// SPDX-License-Identifier: Apache-2.0
#include "diff/network/norm.hpp"

#include <algorithm>

#include "base/assert.hpp"

namespace relidar::network {
namespace {

constexpr std::uint32_t kNormThreads = 64;  // threads per workgroup
constexpr float kMomentum = 0.1f, kEpsilon = 1e-5f;

/// Returns the number of parts into which the pixels of a batch are split. A sum is
/// computed separately for each part. The pixels of a part belong to the same image.
std::uint32_t count_partial_sums_per_channel(const ImageBatchSize& grid) {
    return grid.n * std::uint32_t(std::clamp<std::size_t>(grid.count_pixels_per_image() / 4096, 1, 64));
}
std::size_t count_normalisation_threads(const ChannelSlice& slice) {
    constexpr std::size_t kStretch = std::size_t(kNormThreads) * RELIDAR_NORM_PIXELS;
    return std::size_t(slice.grid.n) * slice.channels *
           ((slice.grid.count_pixels_per_image() + kStretch - 1) / kStretch) * kNormThreads;
}

}  // namespace

NormalisationKernels::NormalisationKernels(Device& device)
    : lanes_(std::uint32_t(device.info().subgroup_size)),
      sums_(device, "diff/network/channel_sums",
            {{SpecialisationConstantId::LANES, lanes_},
             {SpecialisationConstantId::WORKGROUP_SIZE, kNormThreads}},
            SubgroupRequirement::full),
      finish_(device, "diff/network/norm_finish"),
      norm_(device, "diff/network/norm", {{SpecialisationConstantId::WORKGROUP_SIZE, kNormThreads}}),
      norm_vjp_(device, "diff/network/norm_vjp", {{SpecialisationConstantId::WORKGROUP_SIZE, kNormThreads}}),
      sum_parts_(device, "diff/network/sum_parts") {}

void NormalisationKernels::reserve_channel_sums(Device& device, std::uint32_t n_channels,
                                                const ImageBatchSize& grid) {
    partial_.reserve(device, 2 * std::size_t(n_channels) * count_partial_sums_per_channel(grid),
                     "partial sums of channels");
}

shared::ChannelSumsParams NormalisationKernels::make_sums_params(const ChannelSlice& input,
                                                                 std::uint32_t kind) const {
    return {.from = input.view,
            .d_to = input.view,
            .partial = partial_.address(),
            .scale_shift = {},
            .moments = {},
            .kind = kind,
            .n_images = input.grid.n,
            .n_pixels = std::uint32_t(input.grid.count_pixels_per_image()),
            .n_channels = input.channels,
            .n_parts = count_partial_sums_per_channel(input.grid),
            .dropout_key = 0,
            .dropout = 0.0f};
}

void NormalisationKernels::compute_partial_channel_sums(Stream& stream,
                                                        shared::ChannelSumsParams params) const {
    RELIDAR_ASSERT_LE(2 * std::size_t(params.n_channels) * params.n_parts, partial_.size());
    const std::uint32_t of_workgroup = kNormThreads / lanes_, jobs = params.n_channels * params.n_parts;
    run(stream, sums_, std::size_t((jobs + of_workgroup - 1) / of_workgroup) * kNormThreads, params);
}

void NormalisationKernels::compute_scale_and_shift(Stream& stream, const ChannelSlice& input,
                                                   const NormWeights& weights, NormActivations& state,
                                                   bool is_training) const {
    run(stream, finish_, input.channels,
        {.partial = partial_.address(),
         .beta_gamma = weights.beta_gamma,
         .running = weights.running,
         .moments = state.moments.address(),
         .scale_shift = state.scale_shift.address(),
         .n_channels = input.channels,
         .n_parts = count_partial_sums_per_channel(input.grid),
         .n_images = input.grid.n,
         .n_pixels = std::uint32_t(input.grid.count_pixels_per_image()),
         .training = is_training ? 1u : 0u,
         .momentum = kMomentum,
         .epsilon = kEpsilon});
}

void NormalisationKernels::apply_scale_shift_and_relu(Stream& stream, const ChannelSlice& input,
                                                      const NormActivations& state,
                                                      const ChannelSlice& output, bool is_training) const {
    RELIDAR_ASSERT_EQ(input.channels * input.grid.count_all_pixels(),
                      output.channels * output.grid.count_all_pixels());
    run(stream, norm_, count_normalisation_threads(input),
        {.from = input.view,
         .to = output.view,
         .scale_shift = state.scale_shift.address(),
         .n_images = input.grid.n,
         .n_pixels = std::uint32_t(input.grid.count_pixels_per_image()),
         .n_channels = input.channels,
         .dropout_key = state.dropout_key,
         .dropout = is_training ? state.dropout : 0.0f});
}

void NormalisationKernels::run_norm_relu_dropout_for_training(Stream& stream, const ChannelSlice& input,
                                                              const NormWeights& weights,
                                                              NormActivations& state,
                                                              const ChannelSlice& output) {
    compute_partial_channel_sums(stream, make_sums_params(input, shared::kSums_moments));
    compute_scale_and_shift(stream, input, weights, state, true);
    apply_scale_shift_and_relu(stream, input, state, output, true);
}

void NormalisationKernels::run_norm_relu_for_inference(Stream& stream, const ChannelSlice& input,
                                                       const NormWeights& weights, NormActivations& state,
                                                       const ChannelSlice& output) {
    compute_scale_and_shift(stream, input, weights, state, false);
    apply_scale_shift_and_relu(stream, input, state, output, false);
}

void NormalisationKernels::backpropagate_norm_layer(Stream& stream, const ChannelSlice& input,
                                                    const NormActivations& state,
                                                    const ChannelSlice& d_output, const ChannelSlice& d_input,
                                                    const NormGradientTarget& gradient, bool accumulate) {
    shared::ChannelSumsParams sums = make_sums_params(input, shared::kSums_norm_vjp);
    sums.d_to = d_output.view;
    sums.scale_shift = state.scale_shift.address();
    sums.moments = state.moments.address();
    sums.dropout_key = state.dropout_key;
    sums.dropout = state.dropout;
    compute_partial_channel_sums(stream, sums);
    run(stream, sum_parts_, 2 * input.channels,
        {.partial = partial_.address(),
         .sum = gradient.all.address_as<float, shared::SumOfParts>(gradient.first),
         .n_parts = sums.n_parts,
         .n = 2 * input.channels});
    run(stream, norm_vjp_, count_normalisation_threads(input),
        {.from = input.view,
         .d_to = d_output.view,
         .d_from = d_input.view,
         .d_beta_gamma = gradient.all.address_as<glm::vec2, shared::BetaGamma>(gradient.first),
         .scale_shift = state.scale_shift.address(),
         .moments = state.moments.address(),
         .n_images = input.grid.n,
         .n_pixels = sums.n_pixels,
         .n_channels = input.channels,
         .dropout_key = state.dropout_key,
         .dropout = state.dropout,
         .accumulate = accumulate ? 1u : 0u});
}

void NormalisationKernels::backpropagate_bias(Stream& stream, const ChannelSlice& d_output,
                                              Address<float, shared::ConvBias> d_bias) {
    const shared::ChannelSumsParams sums = make_sums_params(d_output, shared::kSums_plain);
    compute_partial_channel_sums(stream, sums);
    run(stream, sum_parts_, d_output.channels,
        {.partial = partial_.address(),
         .sum = d_bias.cast_content_tag<shared::SumOfParts>(),
         .n_parts = sums.n_parts,
         .n = d_output.channels});
}

}  // namespace relidar::network
