// SPDX-License-Identifier: Apache-2.0
// Reduces images by max pooling and enlarges images by bilinear interpolation.
#pragma once

#include "diff/network/tensor.hpp"
#include "gpu/stream.hpp"

namespace relidar::refine {

/// Returns the size of the pooled image: half the rows and half the columns, rounded
/// down.
ImageBatchSize halve_image_size(const ImageBatchSize& grid);

class ResamplingKernels {
public:
    explicit ResamplingKernels(Device& device);

    /// Computes the maximum of each block of 2 x 2 pixels (max pooling).
    /// @param output images of the size halve_image_size(input.grid)
    void max_pool(Stream& stream, const ChannelSlice& input, const ChannelSlice& output);
    /// Computes the gradient of the input of max_pool() and adds it to `d_input`.
    void backpropagate_max_pool(Stream& stream, const ChannelSlice& input, const ChannelSlice& d_output,
                                const ChannelSlice& d_input);
    /// Enlarges `input` to the image size of `output` by bilinear interpolation.
    void upsample_bilinear(Stream& stream, const ChannelSlice& input, const ChannelSlice& output);
    /// Computes the gradient of the input of upsample_bilinear(), `d_input`, from the
    /// gradient of its output, `d_output`.
    void backpropagate_upsample(Stream& stream, const ChannelSlice& d_output, const ChannelSlice& d_input);

private:
    Kernel<shared::ResampleParams> pool_, pool_vjp_, upsample_, upsample_vjp_;
};

}  // namespace relidar::refine
