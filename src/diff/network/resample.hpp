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
    explicit Resampling(Device& device) : device_(device) {}

    /// Maximum of each block of 2 x 2 pixels.
    void max_pool(Stream& stream, const Slice& input, const Slice& output);
    /// Adds to `d_in`.
    void max_pool_vjp(Stream& stream, const Slice& in, const Slice& d_out, const Slice& d_in);
    void upsample(Stream& stream, const Slice& input, const Slice& output);
    void upsample_vjp(Stream& stream, const Slice& d_out, const Slice& d_in);

private:
    Device& device_;
    Kernel<shared::ResampleParams> pool_{device_, "diff/network/pool"};
    Kernel<shared::ResampleParams> pool_vjp_{device_, "diff/network/pool_vjp"};
    Kernel<shared::ResampleParams> upsample_{device_, "diff/network/upsample"};
    Kernel<shared::ResampleParams> upsample_vjp_{device_, "diff/network/upsample_vjp"};
};

}  // namespace relidar::network
