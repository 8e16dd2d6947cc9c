// SPDX-License-Identifier: Apache-2.0
// Reduces images by max pooling and enlarges images by bilinear interpolation.
#pragma once

#include "diff/network/tensor.hpp"
#include "gpu/stream.hpp"

namespace relidar::refine {

/// Returns the size of the pooled image: half the rows and half the columns, rounded
/// down.
Grid halve_grid(const Grid& grid);

class Resample {
public:
    explicit Resample(Device& device);

    /// Computes the maximum of each block of 2 x 2 pixels (max pooling).
    /// @param output images of the size halve_grid(input.grid)
    void pool(Stream& stream, const Slice& input, const Slice& output);
    /// Adds the gradient of the input of pool() to d_from.
    void backpropagate_pool(Stream& stream, const Slice& input, const Slice& d_to, const Slice& d_from);
    /// Enlarges `input` to the image size of `output` by bilinear interpolation.
    void upsample(Stream& stream, const Slice& input, const Slice& output);
    /// Computes dL/d(from) from dL/d(to), the derivative of upsample().
    void backpropagate_upsample(Stream& stream, const Slice& d_to, const Slice& d_from);

private:
    Kernel<shared::ResampleParams> pool_, pool_vjp_, upsample_, upsample_vjp_;
};

}  // namespace relidar::refine
