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

class Norm {
public:
    explicit Norm(Device& device);

    /// Computes out = dropout(relu(gamma x + beta)) for training. x is the input,
    /// normalised with the mean and variance of the batch. Updates the running mean and
    /// variance.
    void normalise_batch(Stream& s, const Slice& in, const NormWeights& w, NormState& n, const Slice& out);
    /// Uses the running mean and variance, and no dropout.
    void normalise(Stream& s, const Slice& in, const NormWeights& w, NormState& n, const Slice& out);
    /// Computes the gradients of the input (d_in), beta and gamma from the gradient of
    /// the output (d_out). Requires an earlier normalise_batch().
    /// @param accumulate true: adds the result to `d_in` instead of overwriting it
    void norm_vjp(Stream& stream, const Slice& in, const NormState& state, const Slice& d_out,
                  const Slice& d_in, const NormGradientTarget& gradient, bool accumulate = false);
    /// Computes the gradient of a bias, [channels]: the sum of each channel over the
    /// pixels of all images.
    void bias_vjp(Stream& stream, const Slice& d_out, Address<float, shared::ConvBias> d_bias);
    void reserve_sums(std::uint32_t n_channels, ImageBatchSize grid);

private:
    static constexpr std::uint32_t kThreads = 64;  ///< threads per workgroup
    static constexpr SpecialisationConstant kWorkgroup{SpecialisationConstantId::WORKGROUP_SIZE, kThreads};

    Device& device_;
    std::uint32_t lanes_ = std::uint32_t(device_.info().subgroup_size);
    Kernel<shared::ChannelSumsParams> sums_;
    Kernel<shared::NormFinishParams> finish_;
    Kernel<shared::NormParams> norm_;
    Kernel<shared::NormVjpParams> norm_vjp_;
    Kernel<shared::SumPartsParams> sum_parts_;
    Array<float, shared::PartSums> partial_;

    shared::ChannelSumsParams make_sums_params(const Slice& input, std::uint32_t kind) const;
    void channel_sums(Stream& stream, shared::ChannelSumsParams params) const;
    std::size_t count_threads(const Slice& slice) const;
    void apply_scale(Stream& s, const Slice& in, const NormState& n, const Slice& out, float drop) const;
    void compute_scale(Stream& s, const Slice& in, const NormWeights& w, NormState& n, bool training) const;
};

}  // namespace relidar::network
