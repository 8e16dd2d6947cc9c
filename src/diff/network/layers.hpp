// SPDX-License-Identifier: Apache-2.0
// Layers of the ray-drop network, and the arrays of images on which they work: [n,
// channels, rows, columns]. Neighbouring columns are adjacent in memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "diff/shared/refine.h"
#include "gpu/stream.hpp"

namespace relidar::network {

struct ImageBatchSize {
    std::uint32_t n = 0, rows = 0, columns = 0;
    bool circular = true;  ///< true: columns wrap around, because the image covers a full turn

    std::size_t n_image_pixels() const { return std::size_t(rows) * columns; }
    std::size_t n_pixels_total() const { return n * n_image_pixels(); }
    friend bool operator==(const ImageBatchSize&, const ImageBatchSize&) = default;
};

inline std::uint32_t div_ceil(std::uint32_t count, std::uint32_t group_size) {
    return (count + group_size - 1) / group_size;
}

constexpr std::uint32_t kLayerThreads = 64;  // threads per workgroup of the kernels of layers

/// Constants of a kernel in which each subgroup has a task.
inline KernelConstants subgroup_constants(std::uint32_t lanes) {
    return {{SpecialisationConstantId::LANES, lanes},
            {SpecialisationConstantId::WORKGROUP_SIZE, kLayerThreads}};
}

/// Returns the number of threads of the workgroups that have at least `n_subgroups`
/// subgroups with `lanes` threads each.
inline std::size_t count_threads(std::uint32_t n_subgroups, std::uint32_t lanes) {
    return std::size_t(div_ceil(n_subgroups, kLayerThreads / lanes)) * kLayerThreads;
}

struct Slice {
    shared::ImageSlice view;
    std::uint32_t channels = 0;
    ImageBatchSize grid;

    Slice channel_range(std::uint32_t first_channel, std::uint32_t n_channels) const {
        return {{view.values, view.channels, view.first + first_channel}, n_channels, grid};
    }
};

struct Tensor {
    std::uint32_t channels = 0;
    ImageBatchSize grid;
    Array<float> values;

    Tensor() = default;
    Tensor(Device& device, std::uint32_t n_channels, ImageBatchSize g, const std::string& text)
        : channels(n_channels), grid(g), values(device, n_channels * g.n_pixels_total(), text) {}
    /// Returns all channels.
    operator Slice() const { return {{values.address(), channels, 0}, channels, grid}; }
    Slice channel_range(std::uint32_t first_channel, std::uint32_t n_channels) const {
        return Slice(*this).channel_range(first_channel, n_channels);
    }
};

/// Convolutions of size 1x1 and 3x3. Pixels outside the image are zero, except that
/// columns wrap around in a circular image.
class Convolution {
public:
    using Weights = Address<float, shared::ConvWeights>;
    using Bias = Address<float, shared::ConvBias>;

    /// Creates the kernels for convolutions of one size.
    /// @param taps number of weights per pair of channels: 1 (1x1) or 9 (3x3)
    /// @throws DeviceError with the name of a missing device feature
    Convolution(Device& device, std::uint32_t taps);

    /// Computes the convolution out = bias + weights * in.
    /// @param weights [out.channels, in.channels, taps]
    /// @param bias [out.channels], or a null address
    /// @param add true: adds the result to `out` instead of overwriting it
    void run_convolution(Stream& stream, const Slice& in, Weights weights, Bias bias, const Slice& out,
                         bool add = false);
    /// Computes the gradient of the input, `d_in`.
    void input_vjp(Stream& stream, const Slice& d_out, Weights weights, const Slice& d_in);
    /// Computes the gradient of the weights, [output channels, input channels, taps].
    void weights_vjp(Stream& stream, const Slice& input, const Slice& d_out, Weights d_weights);
    /// Reserves the temporary memory of weights_vjp().
    void reserve_weight_sums(Device& device, ImageBatchSize grid, std::uint32_t n_in, std::uint32_t n_out);

private:
    std::uint32_t taps_, pixels_, lanes_;
    Kernel<shared::ConvParams> conv_;
    Kernel<shared::ConvWeightsParams> conv_weights_;
    Kernel<shared::SumPartsParams> sum_parts_;
    Array<float, shared::PartSums> partial_;

    static shared::ConvParams make_params(const Slice& from, const Slice& to, Weights weights);
    void run_conv_kernel(Stream& stream, const shared::ConvParams& params) const;
    std::size_t n_weight_threads(const shared::ConvWeightsParams& params) const;
};

struct NormWeights {
    Address<glm::vec2, shared::BetaGamma> beta_gamma;  ///< [channels] beta and gamma of each channel
    /// [channels] mean and variance of each channel, averaged over many batches
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

/// Batch normalisation, ReLU and dropout as one layer. Also computes sums over the pixels
/// of each channel.
class Norm {
public:
    explicit Norm(Device& device);

    /// Computes out = dropout(relu(gamma x + beta)) for training. x is the input with the
    /// mean 0 and variance 1 in the batch. Updates the running mean and variance.
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
    Device& device_;
    std::uint32_t lanes_ = std::uint32_t(device_.info().subgroup_size);
    Kernel<shared::ChannelSumsParams> sums_;    ///< sums pixels over parts of the images
    Kernel<shared::SumPartsParams> sum_parts_;  ///< adds the sums of all parts
    Kernel<shared::NormFinishParams> finish_;   ///< computes scale and shift of each channel
    Kernel<shared::NormParams> norm_;           ///< applies them
    Kernel<shared::NormVjpParams> norm_vjp_;
    Array<float, shared::PartSums> partial_;

    shared::ChannelSumsParams make_sums_params(const Slice& input, std::uint32_t kind) const;
    void channel_sums(Stream& stream, shared::ChannelSumsParams params) const;
    std::size_t count_pixel_threads(const Slice& slice) const;
    void compute_scale(Stream& stream, const Slice& in, const NormWeights& weights, NormState& state,
                       bool train) const;
    void apply_scale(Stream& stream, const Slice& in, const NormState& state, const Slice& out,
                     float dropout) const;
};

/// Half the rows and half the columns, rounded down.
ImageBatchSize half_size(ImageBatchSize grid);

/// Reduces images by max pooling and enlarges images by bilinear interpolation.
class Resampling {
public:
    explicit Resampling(Device& device);

    /// Maximum of each block of 2 x 2 pixels.
    void max_pool(Stream& stream, const Slice& input, const Slice& output);
    /// Adds the gradient of the output to the pixel of `d_in` that was the maximum.
    void max_pool_vjp(Stream& stream, const Slice& in, const Slice& d_out, const Slice& d_in);
    void upsample(Stream& stream, const Slice& input, const Slice& output);
    void upsample_vjp(Stream& stream, const Slice& d_out, const Slice& d_in);

private:
    Kernel<shared::ResampleParams> pool_, pool_vjp_, upsample_, upsample_vjp_;
};

struct AttentionState {
    /// Attention weights [n, heads, pixels, pixels] (softmax of the scores). A row
    /// contains the weights with which one pixel attends to all pixels.
    Tensor share;
    Tensor d_share;  ///< gradient of `share`, scratch memory of the backward pass
};

/// One matrix per image and attention head.
struct HeadMatrices {
    shared::MatrixView view;
    std::uint32_t rows, columns;
};

/// Multi-head self-attention (Vaswani et al.) between the pixels of small images.
class Attention {
public:
    Attention(Device& device, std::uint32_t heads);

    AttentionState allocate_state(ImageBatchSize grid, bool with_gradients) const;
    /// Computes output[h] = V softmax(K^T Q / sqrt(channels per head)) for each head h.
    /// @param qkv query Q, key K, value V of each pixel, [n, 3 channels, rows, columns]
    /// @param output [n, channels, rows, columns]
    void attend(Stream& stream, const Slice& qkv, AttentionState& state, const Slice& output);
    /// Computes the gradient of `qkv` from the gradient of the output.
    void attend_vjp(Stream& stream, const Slice& qkv, AttentionState& state, const Slice& d_out,
                    const Slice& d_qkv);

private:
    Device& device_;
    std::uint32_t heads_, lanes_ = std::uint32_t(device_.info().subgroup_size);
    Kernel<shared::MatmulParams> matmul_;
    Kernel<shared::SoftmaxParams> softmax_;

    void multiply(Stream& stream, std::uint32_t n_images, const HeadMatrices& a, const HeadMatrices& b,
                  const HeadMatrices& c, float scale) const;
    void run_softmax(Stream& stream, const Tensor& share, const Tensor* d_share) const;
};

}  // namespace relidar::network
