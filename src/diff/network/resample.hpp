// SPDX-License-Identifier: Apache-2.0
// Reduces images by max pooling and enlarges images by bilinear interpolation.
#pragma once

#include "diff/network/tensor.hpp"
#include "gpu/stream.hpp"

namespace relidar::network {

/// Half the rows and half the columns, rounded down.
ImageBatchSize half_size(const ImageBatchSize& grid);

class ResamplingKernels {
public:
    explicit ResamplingKernels(Device& device);

    /// Maximum of each block of 2 x 2 pixels.
    void max_pool(Stream& stream, const ChannelSlice& input, const ChannelSlice& output);
    /// Adds to `d_input`.
    void max_pool_vjp(Stream& stream, const ChannelSlice& input, const ChannelSlice& d_output,
                      const ChannelSlice& d_input);
    void upsample(Stream& stream, const ChannelSlice& input, const ChannelSlice& output);
    void upsample_vjp(Stream& stream, const ChannelSlice& d_output, const ChannelSlice& d_input);

private:
    Kernel<shared::ResampleParams> pool_, pool_vjp_, upsample_, upsample_vjp_;
};

}  // namespace relidar::network
