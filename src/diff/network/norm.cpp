// SPDX-License-Identifier: Apache-2.0
#include "diff/network/norm.hpp"

#include <algorithm>

#include "base/assert.hpp"

namespace relidar::network {
namespace {

using enum SpecialisationConstantId;

constexpr std::uint32_t kNormThreads = 64;  // threads per workgroup
constexpr float kNormMomentum = 0.1f, kNormEpsilon = 1e-5f;

/// Returns the number of parts into which the pixels of a batch are split. A sum is
/// computed separately for each part. The pixels of a part belong to the same image.
std::uint32_t count_channel_sums(ImageBatchSize grid) {
    return grid.n * std::uint32_t(std::clamp<std::size_t>(grid.n_image_pixels() / 4096, 1, 64));
}
std::size_t count_norm_threads(const Slice& slice) {
    constexpr std::size_t kPixelsPerWorkgroup = std::size_t(kNormThreads) * RELIDAR_NORM_PIXELS;
    return std::size_t(slice.grid.n) * slice.channels *
           ((slice.grid.n_image_pixels() + kPixelsPerWorkgroup - 1) / kPixelsPerWorkgroup) * kNormThreads;
}

}  // namespace

Normalisation::Normalisation(Device& device)
    : lanes_(std::uint32_t(device.info().subgroup_size)),
      sums_(device, "diff/network/channel_sums",
            {{LANES, lanes_},
             {WORKGROUP_SIZE, kNormThreads}},
            SubgroupRequirement::full),
      finish_(device, "diff/network/norm_finish"),
      norm_(device, "diff/network/norm", {{WORKGROUP_SIZE, kNormThreads}}),
      norm_vjp_(device, "diff/network/norm_vjp", {{WORKGROUP_SIZE, kNormThreads}}),
      sum_parts_(device, "diff/network/sum_parts") {}

void Normalisation::reserve_sums(Device& device, std::uint32_t n_channels,
                                        ImageBatchSize grid) {
    partial_.reserve(device, 2 * std::size_t(n_channels) * count_channel_sums(grid),
                     "partial sums of channels");
}

shared::ChannelSumsParams Normalisation::make_sums_params(const Slice& input,
                                                                 std::uint32_t kind) const {
    return {.from = input.view,
            .d_to = input.view,
            .partial = partial_.address(),
            .scale_shift = {},
            .moments = {},
            .kind = kind,
            .n_images = input.grid.n,
            .n_pixels = std::uint32_t(input.grid.n_image_pixels()),
            .n_channels = input.channels,
            .n_parts = count_channel_sums(input.grid),
            .dropout_key = 0,
            .dropout = 0.0f};
}

void Normalisation::channel_sums(Stream& stream, shared::ChannelSumsParams params) const {
    RELIDAR_ASSERT_LE(2 * std::size_t(params.n_channels) * params.n_parts, partial_.size());
    const std::uint32_t of_workgroup = kNormThreads / lanes_, jobs = params.n_channels * params.n_parts;
    run(stream, sums_, std::size_t((jobs + of_workgroup - 1) / of_workgroup) * kNormThreads, params);
}

void Normalisation::compute_scale(Stream& stream, const Slice& input,
                                         const NormWeights& weights, NormState& state,
                                         bool training) const {
    run(stream, finish_, input.channels,
        {.partial = partial_.address(),
         .beta_gamma = weights.beta_gamma,
         .running = weights.running,
         .moments = state.moments.address(),
         .scale_shift = state.scale_shift.address(),
         .n_channels = input.channels,
         .n_parts = count_channel_sums(input.grid),
         .n_images = input.grid.n,
         .n_pixels = std::uint32_t(input.grid.n_image_pixels()),
         .training = training ? 1u : 0u,
         .momentum = kNormMomentum,
         .epsilon = kNormEpsilon});
}

void Normalisation::apply_scale(Stream& stream, const Slice& input,
                                       const NormState& state, const Slice& output,
                                       bool training) const {
    RELIDAR_ASSERT_EQ(input.channels * input.grid.n_pixels_total(),
                      output.channels * output.grid.n_pixels_total());
    run(stream, norm_, count_norm_threads(input),
        {.from = input.view,
         .to = output.view,
         .scale_shift = state.scale_shift.address(),
         .n_images = input.grid.n,
         .n_pixels = std::uint32_t(input.grid.n_image_pixels()),
         .n_channels = input.channels,
         .dropout_key = state.dropout_key,
         .dropout = training ? state.dropout : 0.0f});
}

void Normalisation::normalise_batch(Stream& stream, const Slice& input,
                                           const NormWeights& weights, NormState& state,
                                           const Slice& output) {
    channel_sums(stream, make_sums_params(input, shared::kMomentSums));
    compute_scale(stream, input, weights, state, true);
    apply_scale(stream, input, state, output, true);
}

void Normalisation::normalise(Stream& stream, const Slice& input, const NormWeights& weights,
                                     NormState& state, const Slice& output) {
    compute_scale(stream, input, weights, state, false);
    apply_scale(stream, input, state, output, false);
}

void Normalisation::norm_vjp(Stream& stream, const Slice& input, const NormState& state,
                                    const Slice& d_out, const Slice& d_in,
                                    const NormGradientTarget& gradient, bool accumulate) {
    shared::ChannelSumsParams sums = make_sums_params(input, shared::kNormVjpSums);
    sums.d_to = d_out.view;
    sums.scale_shift = state.scale_shift.address();
    sums.moments = state.moments.address();
    sums.dropout_key = state.dropout_key;
    sums.dropout = state.dropout;
    channel_sums(stream, sums);
    run(stream, sum_parts_, 2 * input.channels,
        {.partial = partial_.address(),
         .sum = gradient.all.address_as<float, shared::SumOfParts>(gradient.first),
         .n_parts = sums.n_parts,
         .n = 2 * input.channels});
    run(stream, norm_vjp_, count_norm_threads(input),
        {.from = input.view,
         .d_to = d_out.view,
         .d_from = d_in.view,
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

void Normalisation::bias_vjp(Stream& stream, const Slice& d_out,
                                    Address<float, shared::ConvBias> d_bias) {
    const shared::ChannelSumsParams sums = make_sums_params(d_out, shared::kPlainSums);
    channel_sums(stream, sums);
    run(stream, sum_parts_, d_out.channels,
        {.partial = partial_.address(),
         .sum = d_bias.cast_tag<shared::SumOfParts>(),
         .n_parts = sums.n_parts,
         .n = d_out.channels});
}

}  // namespace relidar::network
