// SPDX-License-Identifier: Apache-2.0
// Submits the kernels of batch normalisation: the forward pass for training, the forward
// pass for inference, and the derivatives.
#include "diff/network/norm.hpp"

#include <algorithm>

#include "base/assert.hpp"

namespace relidar::refine {
namespace {

constexpr std::uint32_t kNormThreads = 64;  // threads per workgroup
constexpr float kMomentum = 0.1f, kEpsilon = 1e-5f;

/// Returns the number of parts into which the pixels of a batch are split. Sums are
/// computed part by part. No part extends over two images.
std::uint32_t count_norm_parts(const Grid& grid) {
    return grid.n * std::uint32_t(std::clamp<std::size_t>(grid.pixels() / 4096, 1, 64));
}
/// Returns the number of threads that the kernels need for all pixels of a slice.
std::size_t count_threads(const Slice& slice) {
    constexpr std::size_t kStretch = std::size_t(kNormThreads) * RELIDAR_NORM_PIXELS;
    return std::size_t(slice.grid.n) * slice.channels * ((slice.grid.pixels() + kStretch - 1) / kStretch) *
           kNormThreads;
}

std::vector<Constant> make_subgroup_constants(std::uint32_t lanes) {
    return {{ConstantId::LANES, lanes}, {ConstantId::WORKGROUP_SIZE, kNormThreads}};
}

}  // namespace

Norm::Norm(Device& device)
    : lanes_(std::uint32_t(device.info().subgroup_size)),
      sums_(device, "diff/network/channel_sums", make_subgroup_constants(lanes_), Subgroups::full),
      finish_(device, "diff/network/norm_finish"),
      norm_(device, "diff/network/norm", {{ConstantId::WORKGROUP_SIZE, kNormThreads}}),
      norm_vjp_(device, "diff/network/norm_vjp", {{ConstantId::WORKGROUP_SIZE, kNormThreads}}),
      sum_parts_(device, "diff/network/sum_parts") {}

void Norm::reserve(Device& device, std::uint32_t channels, const Grid& grid) {
    partial_.reserve(device, 2 * std::size_t(channels) * count_norm_parts(grid), "partial sums of channels");
}

void Norm::run_sums(Stream& stream, shared::ChannelSumsParams params) const {
    RELIDAR_ASSERT_LE(2 * std::size_t(params.n_channels) * params.n_parts, partial_.size());
    const std::uint32_t of_workgroup = kNormThreads / lanes_, jobs = params.n_channels * params.n_parts;
    run(stream, sums_, std::size_t((jobs + of_workgroup - 1) / of_workgroup) * kNormThreads, params);
}

void Norm::finish(Stream& stream, const Slice& input, const NormWeights& weights, NormState& state,
                  bool training) const {
    run(stream, finish_, input.channels,
        {.partial = partial_.address(),
         .beta_gamma = weights.beta_gamma,
         .running = weights.running,
         .moments = state.moments.address(),
         .scale_shift = state.scale_shift.address(),
         .n_channels = input.channels,
         .n_parts = count_norm_parts(input.grid),
         .n_images = input.grid.n,
         .n_pixels = std::uint32_t(input.grid.pixels()),
         .training = training ? 1u : 0u,
         .momentum = kMomentum,
         .epsilon = kEpsilon});
}

void Norm::apply(Stream& stream, const Slice& input, const NormState& state, const Slice& output,
                 bool training) const {
    RELIDAR_ASSERT_EQ(input.channels * input.grid.all_pixels(), output.channels * output.grid.all_pixels());
    run(stream, norm_, count_threads(input),
        {.from = input.view,
         .to = output.view,
         .scale_shift = state.scale_shift.address(),
         .n_images = input.grid.n,
         .n_pixels = std::uint32_t(input.grid.pixels()),
         .n_channels = input.channels,
         .dropout_key = state.dropout_key,
         .dropout = training ? state.dropout : 0.0f});
}

void Norm::forward(Stream& stream, const Slice& input, const NormWeights& weights, NormState& state,
                   const Slice& output) {
    run_sums(stream, {.from = input.view,
                      .d_to = input.view,
                      .partial = partial_.address(),
                      .scale_shift = {},
                      .moments = {},
                      .kind = shared::kSums_moments,
                      .n_images = input.grid.n,
                      .n_pixels = std::uint32_t(input.grid.pixels()),
                      .n_channels = input.channels,
                      .n_parts = count_norm_parts(input.grid),
                      .dropout_key = 0,
                      .dropout = 0.0f});
    finish(stream, input, weights, state, true);
    apply(stream, input, state, output, true);
}

void Norm::evaluate(Stream& stream, const Slice& input, const NormWeights& weights, NormState& state,
                    const Slice& output) {
    finish(stream, input, weights, state, false);
    apply(stream, input, state, output, false);
}

void Norm::vjp(Stream& stream, const Slice& input, const NormState& state, const Slice& d_to,
               const Slice& d_from, const NormGradient& gradient, bool accumulate) {
    const auto n_pixels = std::uint32_t(input.grid.pixels()), n_parts = count_norm_parts(input.grid);
    run_sums(stream, {.from = input.view,
                      .d_to = d_to.view,
                      .partial = partial_.address(),
                      .scale_shift = state.scale_shift.address(),
                      .moments = state.moments.address(),
                      .kind = shared::kSums_norm_vjp,
                      .n_images = input.grid.n,
                      .n_pixels = n_pixels,
                      .n_channels = input.channels,
                      .n_parts = n_parts,
                      .dropout_key = state.dropout_key,
                      .dropout = state.dropout});
    run(stream, sum_parts_, 2 * input.channels,
        {.partial = partial_.address(),
         .sum = gradient.all.address_as<float, shared::SumOfParts>(gradient.first),
         .n_parts = n_parts,
         .n = 2 * input.channels});
    run(stream, norm_vjp_, count_threads(input),
        {.from = input.view,
         .d_to = d_to.view,
         .d_from = d_from.view,
         .d_beta_gamma = gradient.all.address_as<glm::vec2, shared::BetaGamma>(gradient.first),
         .scale_shift = state.scale_shift.address(),
         .moments = state.moments.address(),
         .n_images = input.grid.n,
         .n_pixels = n_pixels,
         .n_channels = input.channels,
         .dropout_key = state.dropout_key,
         .dropout = state.dropout,
         .accumulate = accumulate ? 1u : 0u});
}

void Norm::backpropagate_bias(Stream& stream, const Slice& d_to, Address<float, shared::ConvBias> d_bias) {
    const std::uint32_t n_parts = count_norm_parts(d_to.grid);
    run_sums(stream, {.from = d_to.view,
                      .d_to = d_to.view,
                      .partial = partial_.address(),
                      .scale_shift = {},
                      .moments = {},
                      .kind = shared::kSums_plain,
                      .n_images = d_to.grid.n,
                      .n_pixels = std::uint32_t(d_to.grid.pixels()),
                      .n_channels = d_to.channels,
                      .n_parts = n_parts,
                      .dropout_key = 0,
                      .dropout = 0.0f});
    run(stream, sum_parts_, d_to.channels,
        {.partial = partial_.address(),
         .sum = d_bias.as<shared::SumOfParts>(),
         .n_parts = n_parts,
         .n = d_to.channels});
}

}  // namespace relidar::refine
