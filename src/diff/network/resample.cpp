// SPDX-License-Identifier: Apache-2.0
#include "diff/network/resample.hpp"

#include "base/assert.hpp"

namespace relidar::network {
namespace {

shared::ResampleParams resample_params(const ChannelSlice& input, const ChannelSlice& output,
                                       const ImageBatchSize& large_grid, const ImageBatchSize& small_grid) {
    RELIDAR_ASSERT_EQ(input.channels, output.channels);
    RELIDAR_ASSERT_EQ(large_grid.n, small_grid.n);
    return {.from = input.view,
            .to = output.view,
            .pooled = input.view,
            .n_images = large_grid.n,
            .n_channels = input.channels,
            .rows = large_grid.rows,
            .columns = large_grid.columns,
            .small_rows = small_grid.rows,
            .small_columns = small_grid.columns,
            .circular = large_grid.circular ? 1u : 0u};
}

std::size_t count_values(const ChannelSlice& slice) { return slice.channels * slice.grid.n_pixels_total(); }

}  // namespace

ImageBatchSize half_size(const ImageBatchSize& grid) {
    return {grid.n, grid.rows / 2, grid.columns / 2, grid.circular};
}

ResamplingKernels::ResamplingKernels(Device& device)
    : pool_(device, "diff/network/pool"),
      pool_vjp_(device, "diff/network/pool_vjp"),
      upsample_(device, "diff/network/upsample"),
      upsample_vjp_(device, "diff/network/upsample_vjp") {}

void ResamplingKernels::max_pool(Stream& stream, const ChannelSlice& input, const ChannelSlice& output) {
    RELIDAR_ASSERT_EQ(half_size(input.grid) == output.grid, true);
    run(stream, pool_, count_values(output), resample_params(input, output, input.grid, output.grid));
}

void ResamplingKernels::max_pool_vjp(Stream& stream, const ChannelSlice& input, const ChannelSlice& d_output,
                                     const ChannelSlice& d_input) {
    RELIDAR_ASSERT_EQ(half_size(input.grid) == d_output.grid && input.grid == d_input.grid, true);
    shared::ResampleParams params = resample_params(d_output, d_input, input.grid, d_output.grid);
    params.pooled = input.view;
    run(stream, pool_vjp_, count_values(d_output), params);
}

void ResamplingKernels::upsample(Stream& stream, const ChannelSlice& input, const ChannelSlice& output) {
    run(stream, upsample_, count_values(output), resample_params(input, output, output.grid, input.grid));
}

void ResamplingKernels::upsample_vjp(Stream& stream, const ChannelSlice& d_output,
                                     const ChannelSlice& d_input) {
    run(stream, upsample_vjp_, count_values(d_input),
        resample_params(d_output, d_input, d_output.grid, d_input.grid));
}

}  // namespace relidar::network
