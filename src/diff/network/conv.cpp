// SPDX-License-Identifier: Apache-2.0
// Submits the kernels of convolutions: the forward pass and the derivatives with respect
// to images and weights.
#include "diff/network/conv.hpp"

#include <algorithm>
#include <vector>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/assert.hpp"

namespace relidar::refine {
namespace {

constexpr std::uint32_t kConvThreads = 64;  // threads per workgroup
// Number of image rows that form a part. A subgroup sums the gradients of the weights
// over one part, and the sums of all parts are then added.
constexpr std::uint32_t kLinesOfPart = 8;
constexpr std::size_t kMostPartial = 1 << 24;  // maximum number of floats of the partial sums

std::uint32_t count_inputs_of_subgroup(std::uint32_t taps) { return taps == 1 ? RELIDAR_CONV_IN : 1; }

std::uint32_t count_parts(const Grid& grid, std::size_t n_weights) {
    const std::uint32_t lines = grid.n * grid.rows;
    const std::size_t most = std::max<std::size_t>(1, kMostPartial / n_weights);
    return std::uint32_t(std::clamp<std::size_t>(count_groups_of(lines, kLinesOfPart), 1, most));
}

std::uint32_t check_taps(const Device& device, std::uint32_t taps) {
    RELIDAR_ASSERT_EQ(taps == 1 || taps == 9, true);
    const DeviceInfo& info = device.info();
    const std::string missing = list_missing_for_networks(device);
    if (!missing.empty())
        throw DeviceError(
            fmt::format("cannot use the ray-drop network on {}: the device lacks {}; use --set "
                        "refine.enabled=false",
                        info.name, missing));
    return taps;
}

std::uint32_t count_lanes(const Device& device) { return std::uint32_t(device.info().subgroup_size); }
std::uint32_t count_pixels_per_lane(const Device& device) { return prefers_coalesced_access(device) ? 8 : 4; }

Kernel<shared::ConvParams> make_conv(Device& device, std::uint32_t taps) {
    return {device,
            "diff/network/conv",
            {{ConstantId::TAPS, taps},
             {ConstantId::PIXELS, count_pixels_per_lane(device)},
             {ConstantId::LANES, count_lanes(device)},
             {ConstantId::STAGED, prefers_coalesced_access(device) ? 1u : 0u},
             {ConstantId::WORKGROUP_SIZE, kConvThreads}},
            Subgroups::full};
}

Kernel<shared::ConvWeightsParams> make_conv_weights(Device& device, std::uint32_t taps) {
    return {device,
            "diff/network/conv_weights",
            {{ConstantId::TAPS, taps},
             {ConstantId::LANES, count_lanes(device)},
             {ConstantId::WORKGROUP_SIZE, kConvThreads}},
            Subgroups::full};
}

}  // namespace

Conv::Conv(Device& device, std::uint32_t taps)
    : taps_(check_taps(device, taps)),
      pixels_(count_pixels_per_lane(device)),
      lanes_(count_lanes(device)),
      conv_(make_conv(device, taps)),
      conv_weights_(make_conv_weights(device, taps)),
      sum_parts_(device, "diff/network/sum_parts") {}

std::size_t Conv::count_conv_threads(const shared::ConvParams& params) const {
    const std::size_t lines = std::size_t(params.n_images) * params.rows;
    const std::uint32_t segments = std::uint32_t(lines) * count_groups_of(params.columns, lanes_ * pixels_);
    return std::size_t(count_groups_of(segments, kConvThreads / lanes_)) *
           count_groups_of(params.n_out, RELIDAR_CONV_OUT) * kConvThreads;
}

std::size_t Conv::count_weights_threads(const shared::ConvWeightsParams& params) const {
    const std::uint32_t subgroups = params.n_parts *
                                    count_groups_of(params.n_in, count_inputs_of_subgroup(taps_)) *
                                    count_groups_of(params.n_out, RELIDAR_CONV_OUT);
    return std::size_t(count_groups_of(subgroups, kConvThreads / lanes_)) * kConvThreads;
}

void Conv::run_conv(Stream& stream, const shared::ConvParams& params) const {
    run(stream, conv_, count_conv_threads(params), params);
}

void Conv::forward(Stream& stream, const Slice& input, Weights weights, Bias bias, const Slice& output,
                   bool accumulate) {
    RELIDAR_ASSERT_EQ(input.grid.all_pixels(), output.grid.all_pixels());
    run_conv(stream, {.from = input.view,
                      .to = output.view,
                      .weights = weights,
                      .bias = bias,
                      .n_images = input.grid.n,
                      .rows = input.grid.rows,
                      .columns = input.grid.columns,
                      .n_in = input.channels,
                      .n_out = output.channels,
                      .transposed = 0,
                      .accumulate = accumulate ? 1u : 0u});
}

void Conv::backpropagate_input(Stream& stream, const Slice& d_to, Weights weights, const Slice& d_from,
                               bool accumulate) {
    RELIDAR_ASSERT_EQ(d_from.grid.all_pixels(), d_to.grid.all_pixels());
    run_conv(stream, {.from = d_to.view,
                      .to = d_from.view,
                      .weights = weights,
                      .bias = {},
                      .n_images = d_to.grid.n,
                      .rows = d_to.grid.rows,
                      .columns = d_to.grid.columns,
                      .n_in = d_to.channels,
                      .n_out = d_from.channels,
                      .transposed = 1,
                      .accumulate = accumulate ? 1u : 0u});
}

std::size_t Conv::count_partial_floats(const Grid& grid, std::uint32_t n_in, std::uint32_t n_out) const {
    const std::size_t n = std::size_t(n_in) * n_out * taps_;
    return count_parts(grid, n) * n;
}

void Conv::backpropagate_weights(Stream& stream, const Slice& input, const Slice& d_to, Weights d_weights) {
    RELIDAR_ASSERT_EQ(input.grid.all_pixels(), d_to.grid.all_pixels());
    const std::uint32_t n = input.channels * d_to.channels * taps_, n_parts = count_parts(input.grid, n);
    RELIDAR_ASSERT_LE(std::size_t(n_parts) * n, partial_.size());
    const shared::ConvWeightsParams params{.from = input.view,
                                           .d_to = d_to.view,
                                           .partial = partial_.address(),
                                           .n_images = input.grid.n,
                                           .rows = input.grid.rows,
                                           .columns = input.grid.columns,
                                           .n_in = input.channels,
                                           .n_out = d_to.channels,
                                           .n_parts = n_parts};
    run(stream, conv_weights_, count_weights_threads(params), params);
    run(stream, sum_parts_, n,
        {.partial = partial_.address(),
         .sum = d_weights.as<shared::SumOfParts>(),
         .n_parts = n_parts,
         .n = n});
}

}  // namespace relidar::refine
