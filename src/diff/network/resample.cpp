// SPDX-License-Identifier: Apache-2.0
#include "diff/network/layers.hpp"

#include "base/assert.hpp"

namespace relidar::network {
namespace {

/// Returns the parameters of the kernels for pooling, upsampling and their derivatives.
/// @param large,small sizes of the larger and the smaller images. Upsampling and the
/// derivative of pooling read the smaller ones
shared::ResampleParams resample_params(const Slice& in, const Slice& out, ImageBatchSize large,
                                       ImageBatchSize small) {
    RELIDAR_ASSERT_EQ(in.channels, out.channels);
    RELIDAR_ASSERT_EQ(large.n, small.n);
    return {.from = in.view,
            .to = out.view,
            .pooled = {},
            .n_images = large.n,
            .n_channels = in.channels,
            .rows = large.rows,
            .columns = large.columns,
            .small_rows = small.rows,
            .small_columns = small.columns,
            .circular = large.circular ? 1u : 0u};
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

void Resampling::max_pool_vjp(Stream& stream, const Slice& in, const Slice& d_out, const Slice& d_in) {
    RELIDAR_ASSERT_EQ(half_size(in.grid) == d_out.grid && in.grid == d_in.grid, true);
    shared::ResampleParams params = resample_params(d_out, d_in, in.grid, d_out.grid);
    params.pooled = in.view;  // only this kernel needs to know which pixel was the maximum
    run(stream, pool_vjp_, count_values(d_out), params);
}

void Resampling::upsample(Stream& stream, const Slice& input, const Slice& output) {
    run(stream, upsample_, count_values(output), resample_params(input, output, output.grid, input.grid));
}

void Resampling::upsample_vjp(Stream& stream, const Slice& d_out, const Slice& d_in) {
    run(stream, upsample_vjp_, count_values(d_in), resample_params(d_out, d_in, d_out.grid, d_in.grid));
}

}  // namespace relidar::network
