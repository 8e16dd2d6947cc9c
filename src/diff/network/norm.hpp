// SPDX-License-Identifier: Apache-2.0
// Batch normalisation, ReLU and dropout as one layer. Also computes sums over the pixels
// of each channel.
#pragma once

#include "diff/network/tensor.hpp"
#include "gpu/stream.hpp"

namespace relidar::refine {

/// Parameters of a normalisation layer.
struct NormWeights {
    Address<glm::vec2, shared::BetaGamma> beta_gamma;  ///< [channels] beta and gamma of each channel
    /// Running mean and variance of each channel [channels], averaged over many batches.
    /// Used during inference.
    Address<glm::vec2, shared::RunningMoments> running;
};

/// Where the gradients of beta and gamma are written: into an array, starting at index
/// `first`, as [channels, 2].
struct NormGradient {
    const Array<float>& all;
    std::size_t first = 0;
};

/// Intermediate results of a layer that the forward pass stores for the backward pass.
struct NormState {
    Array<glm::vec2, shared::NormMoments> moments;     ///< [channels] mean and 1 / deviation of each channel
    Array<glm::vec2, shared::ScaleShift> scale_shift;  ///< [channels] scale and shift of each channel
    std::uint32_t dropout_key = 0;
    float dropout = 0.0f;

    NormState() = default;
    NormState(Device& device, std::uint32_t channels)
        : moments(device, channels, "moments"), scale_shift(device, channels, "scale and shift") {}
};

/// Kernels of all normalisation layers.
class Norm {
public:
    explicit Norm(Device& device);

    /// Computes output = dropout(relu(gamma x + beta)) for training, where x is the
    /// input, normalised with mean and variance of the batch. Updates the running mean
    /// and variance.
    void forward(Stream& stream, const Slice& input, const NormWeights& weights, NormState& state,
                 const Slice& output);
    /// Computes the layer for inference. Uses the running mean and variance, and no
    /// dropout.
    void evaluate(Stream& stream, const Slice& input, const NormWeights& weights, NormState& state,
                  const Slice& output);
    /// Computes the gradients of the input (d_from), beta and gamma from the gradient of
    /// the output (d_to). Requires an earlier forward().
    /// @param accumulate true: adds the result to `d_from` instead of overwriting it
    void vjp(Stream& stream, const Slice& input, const NormState& state, const Slice& d_to,
             const Slice& d_from, const NormGradient& gradient, bool accumulate = false);
    /// Computes the gradient of a bias, [channels]: the sum of each channel over the
    /// pixels of all images.
    void backpropagate_bias(Stream& stream, const Slice& d_to, Address<float, shared::ConvBias> d_bias);
    /// Allocates memory for images with this number of channels and pixels.
    void reserve(Device& device, std::uint32_t channels, const Grid& grid);

private:
    std::uint32_t lanes_;
    Kernel<shared::ChannelSumsParams> sums_;
    Kernel<shared::NormFinishParams> finish_;
    Kernel<shared::NormParams> norm_;
    Kernel<shared::NormVjpParams> norm_vjp_;
    Kernel<shared::SumPartsParams> sum_parts_;
    Array<float, shared::PartSums> partial_;

    void run_sums(Stream& stream, shared::ChannelSumsParams params) const;
    void apply(Stream& stream, const Slice& input, const NormState& state, const Slice& output,
               bool training) const;
    void finish(Stream& stream, const Slice& input, const NormWeights& weights, NormState& state,
                bool training) const;
};

}  // namespace relidar::refine
