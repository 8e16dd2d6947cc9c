// SPDX-License-Identifier: Apache-2.0
// Submits the kernels of max pooling and bilinear upsampling, and their derivatives.
#include "diff/network/resample.hpp"

#include "base/assert.hpp"

namespace relidar::refine {
namespace {

shared::ResampleParams between(const Slice& from, const Slice& to, const Grid& large, const Grid& small) {
    RELIDAR_ASSERT_EQ(from.channels, to.channels);
    RELIDAR_ASSERT_EQ(large.n, small.n);
    return {.from = from.view,
            .to = to.view,
            .pooled = from.view,
            .n_images = large.n,
            .n_channels = from.channels,
            .rows = large.rows,
            .columns = large.columns,
            .small_rows = small.rows,
            .small_columns = small.columns};
}

std::size_t values_of(const Slice& slice) { return slice.channels * slice.grid.all_pixels(); }

}  // namespace

Grid pooled(const Grid& grid) { return {grid.n, grid.rows / 2, grid.columns / 2}; }

Resample::Resample(Device& device)
    : pool_(device, "diff/network/pool"),
      pool_vjp_(device, "diff/network/pool_vjp"),
      upsample_(device, "diff/network/upsample"),
      upsample_vjp_(device, "diff/network/upsample_vjp") {}

void Resample::pool(Stream& stream, const Slice& from, const Slice& to) {
    RELIDAR_ASSERT_EQ(pooled(from.grid) == to.grid, true);
    run(stream, pool_, values_of(to), between(from, to, from.grid, to.grid));
}

void Resample::pool_vjp(Stream& stream, const Slice& from, const Slice& d_to, const Slice& d_from) {
    RELIDAR_ASSERT_EQ(pooled(from.grid) == d_to.grid && from.grid == d_from.grid, true);
    shared::ResampleParams params = between(d_to, d_from, from.grid, d_to.grid);
    params.pooled = from.view;
    run(stream, pool_vjp_, values_of(d_to), params);
}

void Resample::upsample(Stream& stream, const Slice& from, const Slice& to) {
    run(stream, upsample_, values_of(to), between(from, to, to.grid, from.grid));
}

void Resample::upsample_vjp(Stream& stream, const Slice& d_to, const Slice& d_from) {
    run(stream, upsample_vjp_, values_of(d_from), between(d_to, d_from, d_to.grid, d_from.grid));
}

}  // namespace relidar::refine
