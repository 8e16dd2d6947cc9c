// SPDX-License-Identifier: Apache-2.0
// Batch normalisation, ReLU and dropout as one layer. Also computes sums over the pixels
// of each channel.
#pragma once

#include "diff/network/tensor.hpp"
#include "gpu/stream.hpp"

namespace relidar::network {

struct NormWeights {
    Address<glm::vec2, shared::BetaGamma> beta_gamma;  ///< [channels] beta and gamma of each channel
    /// Running mean and variance of each channel [channels], averaged over many batches.
    /// Used during inference.
    Address<glm::vec2, shared::RunningMoments> running;
};

/// Where to write the gradients of a normalisation layer: [channels, 2] gradients of
/// shift and scale in the array `all`, from index `first`.
struct NormGradientTarget {
    const Array<float>& all;
    std::size_t first = 0;
};

struct NormState {
    Array<glm::vec2, shared::NormMoments> moments;     ///< [channels] mean and 1 / deviation of each channel
    Array<glm::vec2, shared::ScaleShift> scale_shift;  ///< [channels] scale and shift of each channel
    std::uint32_t dropout_key = 0;
    float dropout = 0.0f;

    NormState() = default;
    NormState(Device& device, std::uint32_t channels)
        : moments(device, channels, "moments"), scale_shift(device, channels, "scale and shift") {}
};

class Normalisation {
public:
    explicit Normalisation(Device& device);

    /// Computes output = dropout(relu(gamma x + beta)) for training. x is the input,
    /// normalised with the mean and variance of the batch. Updates the running mean and
    /// variance.
    void normalise_batch(Stream& stream, const Slice& input, const NormWeights& weights,
                         NormState& state, const Slice& output);
    /// Uses the running mean and variance, and no dropout.
    void normalise(Stream& stream, const Slice& input, const NormWeights& weights,
                   NormState& state, const Slice& output);
    /// Computes the gradients of the input (d_in), beta and gamma from the gradient of
    /// the output (d_out). Requires an earlier normalise_batch().
    /// @param accumulate true: adds the result to `d_in` instead of overwriting it
    void norm_vjp(Stream& stream, const Slice& input, const NormState& state,
                  const Slice& d_out, const Slice& d_in,
                  const NormGradientTarget& gradient, bool accumulate = false);
    /// Computes the gradient of a bias, [channels]: the sum of each channel over the
    /// pixels of all images.
    void bias_vjp(Stream& stream, const Slice& d_out, Address<float, shared::ConvBias> d_bias);
    void reserve_sums(Device& device, std::uint32_t n_channels, ImageBatchSize grid);

private:
    std::uint32_t lanes_;
    Kernel<shared::ChannelSumsParams> sums_;
    Kernel<shared::NormFinishParams> finish_;
    Kernel<shared::NormParams> norm_;
    Kernel<shared::NormVjpParams> norm_vjp_;
    Kernel<shared::SumPartsParams> sum_parts_;
    Array<float, shared::PartSums> partial_;

    shared::ChannelSumsParams make_sums_params(const Slice& input, std::uint32_t kind) const;
    void channel_sums(Stream& stream, shared::ChannelSumsParams params) const;
    void apply_scale(Stream& stream, const Slice& input, const NormState& state,
                     const Slice& output, bool training) const;
    void compute_scale(Stream& stream, const Slice& input, const NormWeights& weights,
                       NormState& state, bool training) const;
};

}  // namespace relidar::network
