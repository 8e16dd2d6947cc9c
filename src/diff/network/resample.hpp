// SPDX-License-Identifier: Apache-2.0
// Pooling and upsampling of images.
#pragma once

#include "diff/network/tensor.hpp"
#include "gpu/stream.hpp"

namespace relidar::refine {

/// Returns the image size with half the rows and half the columns, rounded down.
Grid pooled(const Grid& grid);

class Resample {
public:
    explicit Resample(Device& device);

    /// Computes the maximum over each 2 x 2 pixels (max pooling).
    /// @param to  output images of size pooled(from.grid)
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
