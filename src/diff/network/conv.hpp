// SPDX-License-Identifier: Apache-2.0
// Convolutions of size 1x1 and 3x3. Columns wrap around, and rows outside the image are
// zero.
#pragma once

#include <cstdint>

#include "diff/network/tensor.hpp"
#include "gpu/stream.hpp"

namespace relidar::refine {

/// Convolution kernels of one size (1x1 or 3x3), with memory for partial sums of
/// gradients.
class Conv {
public:
    using Weights = Address<float, shared::ConvWeights>;
    using Bias = Address<float, shared::ConvBias>;

    /// Creates the kernels for convolutions of one size.
    /// @param taps number of weights per pair of channels: 1 (1x1) or 9 (3x3)
    /// @throws DeviceError with the name of a missing device feature
    Conv(Device& device, std::uint32_t taps);

    /// Computes the convolution output = bias + weights * input.
    /// @param weights [output.channels, input.channels, taps]
    /// @param bias [output.channels], or a null address
    /// @param accumulate true: adds the result to `output` instead of overwriting it
    void forward(Stream& stream, const Slice& input, Weights weights, Bias bias, const Slice& output,
                 bool accumulate = false);
    /// Computes the gradient of the input, d_from, from the gradient of the output, d_to.
    /// @param accumulate true: adds the result to `d_from` instead of overwriting it
    void backpropagate_input(Stream& stream, const Slice& d_to, Weights weights, const Slice& d_from,
                             bool accumulate = false);
    /// Computes the gradient of the weights, [output channels, input channels, taps].
    /// Adds in a fixed order, so that the result is the same in every run.
    void backpropagate_weights(Stream& stream, const Slice& input, const Slice& d_to, Weights d_weights);
    /// Returns the number of floats that backpropagate_weights() needs for its partial
    /// sums.
    std::size_t count_partial_floats(const Grid& grid, std::uint32_t n_in, std::uint32_t n_out) const;
    void reserve(Device& device, std::size_t floats) {
        partial_.reserve(device, floats, "partial sums of weights");
    }

    std::uint32_t taps() const { return taps_; }

private:
    std::uint32_t taps_, pixels_, lanes_;
    Kernel<shared::ConvParams> conv_;
    Kernel<shared::ConvWeightsParams> conv_weights_;
    Kernel<shared::SumPartsParams> sum_parts_;
    Array<float, shared::PartSums> partial_;

    void run_conv(Stream& stream, const shared::ConvParams& params) const;
    std::size_t count_conv_threads(const shared::ConvParams& params) const;
    std::size_t count_weights_threads(const shared::ConvWeightsParams& params) const;
};

}  // namespace relidar::refine
