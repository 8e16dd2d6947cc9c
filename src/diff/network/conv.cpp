// SPDX-License-Identifier: Apache-2.0
#include "diff/network/layers.hpp"

#include <algorithm>

#include <relidar/base/error.hpp>

#include "base/assert.hpp"
#include "base/fail.hpp"

namespace relidar::network {
namespace {

using enum SpecialisationConstantId;

constexpr std::uint32_t kConvThreads = 64;  // threads per workgroup
// Number of image rows in one part of an image. A subgroup sums the gradients of the
// weights over one part. Then the sums of all parts are added.
constexpr std::uint32_t kLinesOfPart = 8;
constexpr std::size_t kMostPartial = 1 << 24;  // maximum number of floats of the partial sums

/// Returns the number of parts for which partial sums of weight gradients are stored.
/// Large layers get fewer parts, so that the sums need at most kMostPartial floats.
std::uint32_t count_weight_sums(ImageBatchSize grid, std::size_t n_weights) {
    const std::uint32_t lines = grid.n * grid.rows;
    const std::size_t most = std::max<std::size_t>(1, kMostPartial / n_weights);
    return std::uint32_t(std::clamp<std::size_t>(div_ceil(lines, kLinesOfPart), 1, most));
}

/// Checks that the device can run the network. Returns the number of taps, so that an
/// initialiser can call this function.
std::uint32_t check_taps(const Device& device, std::uint32_t kernel_taps) {
    RELIDAR_ASSERT_EQ(kernel_taps == 1 || kernel_taps == 9, true);
    const DeviceInfo& info = device.info();
    const std::string missing = missing_for_networks(device);
    if (!missing.empty())
        fail<DeviceError>(
            "cannot use the ray-drop network on {}: the device lacks {}; use --set refine.enabled=false",
            info.name, missing);
    return kernel_taps;
}

std::uint32_t subgroup_lanes(const Device& device) { return std::uint32_t(device.info().subgroup_size); }
std::uint32_t choose_pixels(const Device& device) { return should_coalesce(device) ? 8 : 4; }

Kernel<shared::ConvParams> make_conv(Device& device, std::uint32_t kernel_taps) {
    return {device,
            "diff/network/conv",
            {{TAPS, kernel_taps},
             {PIXELS, choose_pixels(device)},
             {LANES, subgroup_lanes(device)},
             {STAGED, should_coalesce(device) ? 1u : 0u},
             {WORKGROUP_SIZE, kConvThreads}},
            SubgroupRequirement::full};
}

Kernel<shared::ConvWeightsParams> make_weight_vjp(Device& device, std::uint32_t kernel_taps) {
    return {device,
            "diff/network/conv_weights",
            {{TAPS, kernel_taps}, {LANES, subgroup_lanes(device)}, {WORKGROUP_SIZE, kConvThreads}},
            SubgroupRequirement::full};
}

}  // namespace

Convolution::Convolution(Device& device, std::uint32_t taps)
    : taps_(check_taps(device, taps)),
      pixels_(choose_pixels(device)),
      lanes_(subgroup_lanes(device)),
      conv_(make_conv(device, taps)),
      conv_weights_(make_weight_vjp(device, taps)),
      sum_parts_(device, "diff/network/sum_parts") {}

std::size_t Convolution::n_conv_threads(const shared::ConvParams& params) const {
    const std::size_t lines = std::size_t(params.n_images) * params.rows;
    const std::uint32_t segments = std::uint32_t(lines) * div_ceil(params.columns, lanes_ * pixels_);
    return std::size_t(div_ceil(segments, kConvThreads / lanes_)) * div_ceil(params.n_out, RELIDAR_CONV_OUT) *
           kConvThreads;
}

std::size_t Convolution::n_weight_threads(const shared::ConvWeightsParams& params) const {
    const std::uint32_t input_channels_per_subgroup = taps_ == 1 ? RELIDAR_CONV_IN : 1;
    const std::uint32_t subgroups = params.n_parts * div_ceil(params.n_in, input_channels_per_subgroup) *
                                    div_ceil(params.n_out, RELIDAR_CONV_OUT);
    return std::size_t(div_ceil(subgroups, kConvThreads / lanes_)) * kConvThreads;
}

void Convolution::run_conv_kernel(Stream& stream, const Slice& from, const Slice& to, Weights w, Bias bias,
                                  bool transposed, bool add) const {
    RELIDAR_ASSERT_EQ(from.grid.n_pixels_total(), to.grid.n_pixels_total());
    const shared::ConvParams params{.from = from.view,
                                    .to = to.view,
                                    .weights = w,
                                    .bias = bias,
                                    .n_images = from.grid.n,
                                    .rows = from.grid.rows,
                                    .columns = from.grid.columns,
                                    .n_in = from.channels,
                                    .n_out = to.channels,
                                    .transposed = transposed ? 1u : 0u,
                                    .accumulate = add ? 1u : 0u,
                                    .circular = from.grid.circular ? 1u : 0u};
    run(stream, conv_, n_conv_threads(params), params);
}

void Convolution::run_convolution(Stream& s, const Slice& in, Weights w, Bias b, const Slice& out, bool add) {
    run_conv_kernel(s, in, out, w, b, false, add);
}

void Convolution::input_vjp(Stream& stream, const Slice& d_out, Weights weights, const Slice& d_in) {
    // The gradient of the input is a convolution with transposed weights.
    run_conv_kernel(stream, d_out, d_in, weights, {}, true, false);
}

std::size_t Convolution::n_partial_sums(ImageBatchSize grid, std::uint32_t n_in, std::uint32_t n_out) const {
    const std::size_t n = std::size_t(n_in) * n_out * taps_;
    return count_weight_sums(grid, n) * n;
}

/// Computes the gradient of the weights: first partial sums over parts of the images,
/// then their sum, in a fixed order instead of with atomics.
void Convolution::weights_vjp(Stream& stream, const Slice& input, const Slice& d_out, Weights d_weights) {
    RELIDAR_ASSERT_EQ(input.grid.n_pixels_total(), d_out.grid.n_pixels_total());
    const std::uint32_t n = input.channels * d_out.channels * taps_,
                        n_parts = count_weight_sums(input.grid, n);
    RELIDAR_ASSERT_LE(std::size_t(n_parts) * n, partial_.size());
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
    run(stream, sum_parts_, n,
        {.partial = partial_.address(),
         .sum = d_weights.cast_tag<shared::SumOfParts>(),
         .n_parts = n_parts,
         .n = n});
}

}  // namespace relidar::network
