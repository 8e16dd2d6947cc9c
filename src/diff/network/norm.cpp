// SPDX-License-Identifier: Apache-2.0
#include "diff/network/layers.hpp"

#include <algorithm>

#include "base/assert.hpp"

namespace relidar::network {
namespace {

using enum SpecialisationConstantId;

constexpr SpecialisationConstant kWorkgroup{WORKGROUP_SIZE, kLayerThreads};
constexpr float kNormMomentum = 0.1f, kNormEpsilon = 1e-5f;

/// Returns the number of parts into which the pixels of a batch are split. A sum is
/// computed separately for each part. The pixels of a part belong to the same image.
std::uint32_t count_channel_sums(ImageBatchSize grid) {
    constexpr std::size_t kPixelsPerPart = 4096, kMaxPartsPerImage = 64;
    return grid.n * std::uint32_t(std::clamp<std::size_t>(grid.n_image_pixels() / kPixelsPerPart, 1,
                                                          kMaxPartsPerImage));
}

}  // namespace

Norm::Norm(Device& device)
    : device_(device),
      sums_(device, "diff/network/channel_sums", subgroup_constants(lanes_), SubgroupRequirement::full),
      sum_parts_(device, "diff/network/sum_parts"),
      finish_(device, "diff/network/norm_finish"),
      norm_(device, "diff/network/norm", {kWorkgroup}),
      norm_vjp_(device, "diff/network/norm_vjp", {kWorkgroup}) {}

/// Returns the number of threads that process all pixels of a slice. A workgroup
/// processes pixels of a single channel, and a thread RELIDAR_NORM_PIXELS of them.
std::size_t Norm::count_pixel_threads(const Slice& slice) const {
    constexpr std::size_t kPixelsPerWorkgroup = std::size_t(kLayerThreads) * RELIDAR_NORM_PIXELS;
    const std::size_t workgroups_per_channel =
        (slice.grid.n_image_pixels() + kPixelsPerWorkgroup - 1) / kPixelsPerWorkgroup;
    return slice.grid.n * slice.channels * workgroups_per_channel * kLayerThreads;
}

void Norm::reserve_sums(std::uint32_t n_channels, ImageBatchSize grid) {
    partial_.reserve(device_, 2 * std::size_t(n_channels) * count_channel_sums(grid),
                     "partial sums of channels");
}

/// Returns the parameters of a sum over the pixels of each channel.
/// @param kind what is summed: kMomentSums, kNormVjpSums or kPlainSums
shared::ChannelSumsParams Norm::make_sums_params(const Slice& input, std::uint32_t kind) const {
    shared::ChannelSumsParams params{};
    params.from = input.view;
    params.d_to = input.view;  // placeholder, only kNormVjpSums reads the gradient
    params.partial = partial_.address();
    params.kind = kind;
    params.n_images = input.grid.n;
    params.n_pixels = std::uint32_t(input.grid.n_image_pixels());
    params.n_channels = input.channels;
    params.n_parts = count_channel_sums(input.grid);
    return params;
}

/// Submits the kernel that sums the pixels of each channel over parts of the images. One
/// subgroup computes the sum of one part of one channel.
void Norm::channel_sums(Stream& stream, shared::ChannelSumsParams params) const {
    RELIDAR_ASSERT_LE(2 * std::size_t(params.n_channels) * params.n_parts, partial_.size());
    run(stream, sums_, count_threads(params.n_channels * params.n_parts, lanes_), params);
}

/// Submits the kernel that computes the scale and shift that normalise each channel,
/// including gamma and beta.
/// @param train true: uses the mean and variance of this batch, from the partial sums of
/// its pixels, and updates the running values. false: uses the running values.
void Norm::compute_scale(Stream& stream, const Slice& in, const NormWeights& weights, NormState& state,
                         bool train) const {
    run(stream, finish_, in.channels,
        {.partial = partial_.address(),
         .beta_gamma = weights.beta_gamma,
         .running = weights.running,
         .moments = state.moments.address(),
         .scale_shift = state.scale_shift.address(),
         .n_channels = in.channels,
         .n_parts = count_channel_sums(in.grid),
         .n_images = in.grid.n,
         .n_pixels = std::uint32_t(in.grid.n_image_pixels()),
         .training = train ? 1u : 0u,
         .momentum = kNormMomentum,
         .epsilon = kNormEpsilon});
}

/// Submits the kernel that computes out = dropout(relu(scale * in + shift)).
/// @param dropout share of the values that become 0, selected by `state.dropout_key`
void Norm::apply_scale(Stream& stream, const Slice& in, const NormState& state, const Slice& out,
                       float dropout) const {
    RELIDAR_ASSERT_EQ(in.channels * in.grid.n_pixels_total(), out.channels * out.grid.n_pixels_total());
    run(stream, norm_, count_pixel_threads(in),
        {.from = in.view,
         .to = out.view,
         .scale_shift = state.scale_shift.address(),
         .n_images = in.grid.n,
         .n_pixels = std::uint32_t(in.grid.n_image_pixels()),
         .n_channels = in.channels,
         .dropout_key = state.dropout_key,
         .dropout = dropout});
}

void Norm::normalise_batch(Stream& s, const Slice& in, const NormWeights& w, NormState& n, const Slice& out) {
    channel_sums(s, make_sums_params(in, shared::kMomentSums));
    compute_scale(s, in, w, n, true);
    apply_scale(s, in, n, out, n.dropout);
}

void Norm::normalise(Stream& s, const Slice& in, const NormWeights& w, NormState& n, const Slice& out) {
    compute_scale(s, in, w, n, false);
    apply_scale(s, in, n, out, 0.0f);
}

/// Computes the gradients of beta and gamma, and then of the input. With the gradient g
/// of the normalised and scaled value y = gamma x' + beta:
///   d_beta = sum g,   d_gamma = sum g x'   (over the pixels of the batch)
///   d_x = scale (g - mean(g) - x' mean(g x')),   because x also changes mean and variance
void Norm::norm_vjp(Stream& stream, const Slice& in, const NormState& state, const Slice& d_out,
                    const Slice& d_in, const NormGradientTarget& gradient, bool accumulate) {
    shared::ChannelSumsParams sums = make_sums_params(in, shared::kNormVjpSums);
    sums.d_to = d_out.view;
    sums.scale_shift = state.scale_shift.address();
    sums.moments = state.moments.address();
    sums.dropout_key = state.dropout_key;
    sums.dropout = state.dropout;
    channel_sums(stream, sums);                    // over parts of the images
    const std::uint32_t n_sums = 2 * in.channels;  // sum g, sum g x' of each channel
    run(stream, sum_parts_, n_sums,
        {.partial = partial_.address(),
         .sum = gradient.all.address_as<float, shared::SumOfParts>(gradient.first),
         .n_parts = sums.n_parts,
         .n = n_sums});
    run(stream, norm_vjp_, count_pixel_threads(in),
        {.from = in.view,
         .d_to = d_out.view,
         .d_from = d_in.view,
         .d_beta_gamma = gradient.all.address_as<glm::vec2, shared::BetaGamma>(gradient.first),
         .scale_shift = state.scale_shift.address(),
         .moments = state.moments.address(),
         .n_images = in.grid.n,
         .n_pixels = sums.n_pixels,
         .n_channels = in.channels,
         .dropout_key = state.dropout_key,
         .dropout = state.dropout,
         .accumulate = accumulate ? 1u : 0u});
}

void Norm::bias_vjp(Stream& stream, const Slice& d_out, Address<float, shared::ConvBias> d_bias) {
    const shared::ChannelSumsParams sums = make_sums_params(d_out, shared::kPlainSums);
    channel_sums(stream, sums);
    run(stream, sum_parts_, d_out.channels,
        {.partial = partial_.address(),
         .sum = d_bias.cast_tag<shared::SumOfParts>(),
         .n_parts = sums.n_parts,
         .n = d_out.channels});
}

}  // namespace relidar::network
