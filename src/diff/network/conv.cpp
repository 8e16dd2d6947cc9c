// SPDX-License-Identifier: Apache-2.0
#include "diff/network/layers.hpp"

#include <algorithm>

#include <relidar/base/error.hpp>

#include "base/assert.hpp"
#include "base/fail.hpp"

namespace relidar::network {
namespace {

using enum SpecialisationConstantId;

// Number of image rows in one part of an image. A subgroup sums the gradients of the
// weights over one part. Then the sums of all parts are added.
constexpr std::uint32_t kLinesOfPart = 8;
constexpr std::size_t kMostPartial = 1 << 24;  // maximum number of floats of the partial sums

/// Returns the number of parts into which the images are split for the gradient of the
/// weights. Each part needs a sum per weight. Layers with many weights get fewer parts,
/// so that all sums need at most kMostPartial floats.
std::uint32_t count_weight_sums(ImageBatchSize grid, std::size_t n_weights) {
    const std::uint32_t n_rows = grid.n * grid.rows;
    const std::size_t max_parts = std::max<std::size_t>(1, kMostPartial / n_weights);
    return std::uint32_t(std::clamp<std::size_t>(div_ceil(n_rows, kLinesOfPart), 1, max_parts));
}

/// Checks that the device can run the network. Returns `taps` (the number of weights per
/// pair of channels), so that the constructor can call it before it creates kernels.
std::uint32_t check_taps(const Device& device, std::uint32_t taps) {
    RELIDAR_ASSERT_EQ(taps == 1 || taps == 9, true);
    const DeviceInfo& info = device.info();
    const std::string missing = missing_for_networks(device);
    if (!missing.empty())
        fail<DeviceError>(
            "cannot use the ray-drop network on {}: the device lacks {}; use --set refine.enabled=false",
            info.name, missing);
    return taps;
}

/// Returns how many pixels of an image row each lane (thread of a subgroup) computes. A
/// CPU has fewer registers than a GPU for the sums of these pixels, so it computes fewer.
std::uint32_t count_lane_pixels(const Device& device) {
    const bool is_gpu = should_coalesce(device);
    return is_gpu ? 8 : 4;
}

/// Creates the kernel that computes a convolution (shaders/diff/network/conv.comp).
/// @param taps number of weights per pair of an input and an output channel
/// @param lanes number of threads of a subgroup
Kernel<shared::ConvParams> make_conv_kernel(Device& device, std::uint32_t taps, std::uint32_t lanes) {
    // On a GPU, the threads of a workgroup load the weights into shared memory (STAGED).
    // On a CPU, it is faster if each lane loads some weights and the lanes exchange them.
    const std::uint32_t staged = should_coalesce(device) ? 1 : 0;
    return {device,
            "diff/network/conv",
            {{TAPS, taps},
             {PIXELS, count_lane_pixels(device)},
             {LANES, lanes},
             {STAGED, staged},
             {WORKGROUP_SIZE, kLayerThreads}},
            SubgroupRequirement::full};
}

}  // namespace

Convolution::Convolution(Device& device, std::uint32_t taps)
    : taps_(check_taps(device, taps)),
      pixels_(count_lane_pixels(device)),
      lanes_(std::uint32_t(device.info().subgroup_size)),
      conv_(make_conv_kernel(device, taps, lanes_)),
      conv_weights_(device, "diff/network/conv_weights",
                    {{TAPS, taps}, {LANES, lanes_}, {WORKGROUP_SIZE, kLayerThreads}},
                    SubgroupRequirement::full),
      sum_parts_(device, "diff/network/sum_parts") {}

/// Runs the convolution kernel. Each subgroup computes RELIDAR_CONV_OUT output channels
/// of a segment: a piece of an image row with `pixels_` pixels per lane.
void Convolution::run_conv_kernel(Stream& stream, const shared::ConvParams& params) const {
    const std::uint32_t n_segments =
        params.n_images * params.rows * div_ceil(params.columns, lanes_ * pixels_);
    const std::uint32_t n_channel_groups = div_ceil(params.n_out, RELIDAR_CONV_OUT);
    run(stream, conv_, count_threads(n_segments, lanes_) * n_channel_groups, params);
}

/// Returns the number of threads that compute the gradient of the weights. A subgroup
/// computes, for one part of the images, the weights between RELIDAR_CONV_OUT output
/// channels and one input channel. For 1x1 it computes RELIDAR_CONV_IN input channels.
std::size_t Convolution::n_weight_threads(const shared::ConvWeightsParams& params) const {
    const std::uint32_t in_channels_per_subgroup = taps_ == 1 ? RELIDAR_CONV_IN : 1;
    const std::uint32_t n_subgroups = params.n_parts * div_ceil(params.n_in, in_channels_per_subgroup) *
                                      div_ceil(params.n_out, RELIDAR_CONV_OUT);
    return count_threads(n_subgroups, lanes_);
}

/// Returns the parameters of a convolution. Without further changes, it has no bias and
/// overwrites `to`.
shared::ConvParams Convolution::make_params(const Slice& from, const Slice& to, Weights weights) {
    RELIDAR_ASSERT_EQ(from.grid.n_pixels_total(), to.grid.n_pixels_total());
    shared::ConvParams params{};
    params.from = from.view;
    params.to = to.view;
    params.weights = weights;
    params.n_images = from.grid.n;
    params.rows = from.grid.rows;
    params.columns = from.grid.columns;
    params.n_in = from.channels;
    params.n_out = to.channels;
    params.circular = from.grid.circular ? 1 : 0;
    return params;
}

void Convolution::run_convolution(Stream& stream, const Slice& in, Weights weights, Bias bias,
                                  const Slice& out, bool add) {
    shared::ConvParams params = make_params(in, out, weights);
    params.bias = bias;
    params.accumulate = add ? 1 : 0;
    run_conv_kernel(stream, params);
}

void Convolution::input_vjp(Stream& stream, const Slice& d_out, Weights weights, const Slice& d_in) {
    // The gradient of the input is a convolution with transposed weights.
    shared::ConvParams params = make_params(d_out, d_in, weights);
    params.transposed = 1;
    run_conv_kernel(stream, params);
}

void Convolution::reserve_weight_sums(Device& device, ImageBatchSize grid, std::uint32_t n_in,
                                      std::uint32_t n_out) {
    const std::size_t n_weights = std::size_t(n_in) * n_out * taps_;
    partial_.reserve(device, count_weight_sums(grid, n_weights) * n_weights, "partial sums of weights");
}

/// Computes the gradient of the weights: the sum over all pixels of input values times
/// output gradients. The first kernel sums over each part of the images, the second adds
/// the parts. Uses no atomics, whose order differs between runs.
void Convolution::weights_vjp(Stream& stream, const Slice& input, const Slice& d_out, Weights d_weights) {
    RELIDAR_ASSERT_EQ(input.grid.n_pixels_total(), d_out.grid.n_pixels_total());
    const std::uint32_t n_weights = input.channels * d_out.channels * taps_;
    const std::uint32_t n_parts = count_weight_sums(input.grid, n_weights);
    RELIDAR_ASSERT_LE(std::size_t(n_parts) * n_weights, partial_.size());
    const shared::ConvWeightsParams params{.from = input.view,
                                           .d_to = d_out.view,
                                           .partial = partial_.address(),
                                           .n_images = input.grid.n,
                                           .rows = input.grid.rows,
                                           .columns = input.grid.columns,
                                           .n_in = input.channels,
                                           .n_out = d_out.channels,
                                           .n_parts = n_parts,
                                           .circular = input.grid.circular ? 1u : 0u};
    run(stream, conv_weights_, n_weight_threads(params), params);
    run(stream, sum_parts_, n_weights,
        {.partial = partial_.address(),
         .sum = d_weights.cast_tag<shared::SumOfParts>(),
         .n_parts = n_parts,
         .n = n_weights});
}

}  // namespace relidar::network
