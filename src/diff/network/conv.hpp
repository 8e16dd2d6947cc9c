// SPDX-License-Identifier: Apache-2.0
// Convolutions of size 1x1 and 3x3. Pixels outside the image are zero, except that
// columns wrap around in a circular image.
#pragma once

#include <cstdint>

#include "diff/network/tensor.hpp"
#include "gpu/stream.hpp"

namespace relidar::network {

class Convolution {
public:
    using Weights = Address<float, shared::ConvWeights>;
    using Bias = Address<float, shared::ConvBias>;

    /// Creates the kernels for convolutions of one size.
    /// @param taps number of weights per pair of channels: 1 (1x1) or 9 (3x3)
    /// @throws DeviceError with the name of a missing device feature
    Convolution(Device& device, std::uint32_t taps);

    /// Computes the convolution out = bias + w * in.
    /// @param w [output.channels, input.channels, taps]
    /// @param bias [output.channels], or a null address
    /// @param add true: adds the result to `out` instead of overwriting it
    void run_convolution(Stream& s, const Slice& in, Weights w, Bias b, const Slice& out, bool add = false);
    /// Computes the gradient of the input, `d_in`.
    void input_vjp(Stream& stream, const Slice& d_out, Weights weights, const Slice& d_in);
    /// Computes the gradient of the weights, [output channels, input channels, taps].
    /// Adds in a fixed order, so that every run gives the same result.
    void weights_vjp(Stream& stream, const Slice& input, const Slice& d_out, Weights d_weights);
    std::size_t n_partial_sums(ImageBatchSize grid, std::uint32_t n_in, std::uint32_t n_out) const;
    void reserve_weight_sums(Device& device, std::size_t n_floats) {
        partial_.reserve(device, n_floats, "partial sums of weights");
    }

private:
    std::uint32_t taps_, pixels_, lanes_;
    Kernel<shared::ConvParams> conv_;
    Kernel<shared::ConvWeightsParams> conv_weights_;
    Kernel<shared::SumPartsParams> sum_parts_;
    Array<float, shared::PartSums> partial_;

    void run_conv_kernel(Stream& stream, const Slice& from, const Slice& to, Weights w, Bias bias,
                         bool transposed, bool add) const;
    std::size_t n_conv_threads(const shared::ConvParams& params) const;
    std::size_t n_weight_threads(const shared::ConvWeightsParams& params) const;
};

}  // namespace relidar::network
