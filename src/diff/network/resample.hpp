// SPDX-License-Identifier: Apache-2.0
// Pooling and upsampling of images.
#pragma once

#include "diff/network/tensor.hpp"
#include "gpu/stream.hpp"

namespace relidar::refine {

/// Returns the grid with half the rows and columns, rounded down.
Grid pooled(const Grid& grid);

class Resample {
public:
    explicit Resample(Device& device);

    /// Computes the maximum over 2 x 2 pixels.
    /// @param to  images of the grid pooled(from.grid)
    void pool(Stream& stream, const Slice& from, const Slice& to);
    /// Adds dL/d(from) of pool() to d_from.
    void pool_vjp(Stream& stream, const Slice& from, const Slice& d_to, const Slice& d_from);
    /// Interpolates bilinearly to the grid of `to`.
    void upsample(Stream& stream, const Slice& from, const Slice& to);
    /// Computes dL/d(from) of upsample().
    void upsample_vjp(Stream& stream, const Slice& d_to, const Slice& d_from);

private:
    Kernel<shared::ResampleParams> pool_, pool_vjp_, upsample_, upsample_vjp_;
};

}  // namespace relidar::refine
