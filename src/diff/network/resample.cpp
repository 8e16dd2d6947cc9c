// SPDX-License-Identifier: Apache-2.0
// Submits the kernels of max pooling and bilinear upsampling, and their derivatives.
#include "diff/network/resample.hpp"

#include "base/assert.hpp"

namespace relidar::refine {
namespace {

shared::ResampleParams make_resample_params(const Slice& input, const Slice& output, const Grid& large,
                                            const Grid& small) {
    RELIDAR_ASSERT_EQ(input.channels, output.channels);
    RELIDAR_ASSERT_EQ(large.n, small.n);
    return {.from = input.view,
            .to = output.view,
            .pooled = input.view,
            .n_images = large.n,
            .n_channels = input.channels,
            .rows = large.rows,
            .columns = large.columns,
            .small_rows = small.rows,
            .small_columns = small.columns};
}

std::size_t count_values(const Slice& slice) { return slice.channels * slice.grid.all_pixels(); }

}  // namespace

Grid halve_grid(const Grid& grid) { return {grid.n, grid.rows / 2, grid.columns / 2}; }

Resample::Resample(Device& device)
    : pool_(device, "diff/network/pool"),
      pool_vjp_(device, "diff/network/pool_vjp"),
      upsample_(device, "diff/network/upsample"),
      upsample_vjp_(device, "diff/network/upsample_vjp") {}

void Resample::pool(Stream& stream, const Slice& input, const Slice& output) {
    RELIDAR_ASSERT_EQ(halve_grid(input.grid) == output.grid, true);
    run(stream, pool_, count_values(output), make_resample_params(input, output, input.grid, output.grid));
}

void Resample::backpropagate_pool(Stream& stream, const Slice& input, const Slice& d_to,
                                  const Slice& d_from) {
    RELIDAR_ASSERT_EQ(halve_grid(input.grid) == d_to.grid && input.grid == d_from.grid, true);
    shared::ResampleParams params = make_resample_params(d_to, d_from, input.grid, d_to.grid);
    params.pooled = input.view;
    run(stream, pool_vjp_, count_values(d_to), params);
}

void Resample::upsample(Stream& stream, const Slice& input, const Slice& output) {
    run(stream, upsample_, count_values(output),
        make_resample_params(input, output, output.grid, input.grid));
}

void Resample::backpropagate_upsample(Stream& stream, const Slice& d_to, const Slice& d_from) {
    run(stream, upsample_vjp_, count_values(d_from),
        make_resample_params(d_to, d_from, d_to.grid, d_from.grid));
}

}  // namespace relidar::refine
