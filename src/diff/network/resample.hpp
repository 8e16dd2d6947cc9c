// SPDX-License-Identifier: Apache-2.0
// Reduces images by max pooling and enlarges images by bilinear interpolation.
#pragma once

#include "diff/network/tensor.hpp"
#include "gpu/stream.hpp"

namespace relidar::refine {

/// Returns the size of the pooled image: half the rows and half the columns, rounded
/// down.
Grid pooled(const Grid& grid);

class Resample {
public:
    explicit Resample(Device& device);

    /// Computes the maximum of each block of 2 x 2 pixels (max pooling).
    /// @param to output images of size pooled(from.grid)
    void pool(Stream& stream, const Slice& from, const Slice& to);
    /// Computes the derivative of pool() and adds it to d_from.
    void pool_vjp(Stream& stream, const Slice& from, const Slice& d_to, const Slice& d_from);
    /// Enlarges `from` to the image size of `to` by bilinear interpolation.
    void upsample(Stream& stream, const Slice& from, const Slice& to);
    /// Computes dL/d(from) from dL/d(to), the derivative of upsample().
    void upsample_vjp(Stream& stream, const Slice& d_to, const Slice& d_from);

private:
    Kernel<shared::ResampleParams> pool_, pool_vjp_, upsample_, upsample_vjp_;
};

}  // namespace relidar::refine
