// SPDX-License-Identifier: Apache-2.0
#include "diff/network/resample.hpp"

#include "base/assert.hpp"

namespace relidar::network {
namespace {

shared::ResampleParams resample_params(const Slice& input, const Slice& output, ImageBatchSize large_grid,
                                       ImageBatchSize small_grid) {
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

std::size_t count_values(const Slice& slice) { return slice.channels * slice.grid.n_pixels_total(); }

}  // namespace

ImageBatchSize half_size(ImageBatchSize grid) {
    return {grid.n, grid.rows / 2, grid.columns / 2, grid.circular};
}

Resampling::Resampling(Device& device)
    : pool_(device, "diff/network/pool"),
      pool_vjp_(device, "diff/network/pool_vjp"),
      upsample_(device, "diff/network/upsample"),
      upsample_vjp_(device, "diff/network/upsample_vjp") {}

void Resampling::max_pool(Stream& stream, const Slice& input, const Slice& output) {
    RELIDAR_ASSERT_EQ(half_size(input.grid) == output.grid, true);
    run(stream, pool_, count_values(output), resample_params(input, output, input.grid, output.grid));
}

void Resampling::max_pool_vjp(Stream& stream, const Slice& input, const Slice& d_out, const Slice& d_in) {
    RELIDAR_ASSERT_EQ(half_size(input.grid) == d_out.grid && input.grid == d_in.grid, true);
    shared::ResampleParams params = resample_params(d_out, d_in, input.grid, d_out.grid);
    params.pooled = input.view;
    run(stream, pool_vjp_, count_values(d_out), params);
}

void Resampling::upsample(Stream& stream, const Slice& input, const Slice& output) {
    run(stream, upsample_, count_values(output), resample_params(input, output, output.grid, input.grid));
}

void Resampling::upsample_vjp(Stream& stream, const Slice& d_out, const Slice& d_in) {
    run(stream, upsample_vjp_, count_values(d_in), resample_params(d_out, d_in, d_out.grid, d_in.grid));
}

}  // namespace relidar::network
