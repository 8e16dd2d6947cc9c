// SPDX-License-Identifier: Apache-2.0
// Reduces images by max pooling and enlarges images by bilinear interpolation.
#pragma once

#include "diff/network/tensor.hpp"
#include "gpu/stream.hpp"

namespace relidar::network {

/// Half the rows and half the columns, rounded down.
ImageBatchSize half_size(ImageBatchSize grid);

class Resampling {
public:
    explicit Resampling(Device& device);

    /// Maximum of each block of 2 x 2 pixels.
    void max_pool(Stream& stream, const Slice& input, const Slice& output);
    /// Adds to `d_in`.
    void max_pool_vjp(Stream& stream, const Slice& in, const Slice& d_out, const Slice& d_in);
    void upsample(Stream& stream, const Slice& input, const Slice& output);
    void upsample_vjp(Stream& stream, const Slice& d_out, const Slice& d_in);

private:
    Kernel<shared::ResampleParams> pool_, pool_vjp_, upsample_, upsample_vjp_;
};

}  // namespace relidar::network
