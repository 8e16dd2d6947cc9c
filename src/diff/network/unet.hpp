// SPDX-License-Identifier: Apache-2.0
// Implements the ray-drop network as a U-Net (Ronneberger et al.). Each level has two
// blocks of [normalisation, ReLU, dropout, convolution] and a skip connection. The level
// with the smallest images also has attention. Stores the parameters, and runs passes
// over images of one size.
#pragma once

#include <array>
#include <optional>
#include <vector>

#include <relidar/diff/network.hpp>

#include "diff/network/layers.hpp"

namespace relidar::network {

/// Channels of a convolution, and the offsets of its parameters in the parameter array.
/// Its weights have the shape [n_out, n_in, taps], with 1 tap (1x1) or 9 taps (3x3).
struct ConvOffsets {
    std::uint32_t n_in = 0, n_out = 0, taps = 1;
    std::size_t weights = 0;
    std::optional<std::size_t> bias = {};
};

/// Offsets of a block's parameters in the parameter array. A block is normalisation,
/// ReLU, dropout, convolution.
struct BlockOffsets {
    std::size_t beta_gamma = 0, running = 0;
    ConvOffsets conv;
};

struct UnetLayout {
    /// `first_conv` converts the inputs to the channels of the first level. `last_conv`
    /// converts these channels to a logit.
    ConvOffsets first_conv, last_conv;
    /// Blocks of the encoder (`down`) and of the decoder (`up`), two per level. Each list
    /// starts with the level of full image size.
    std::vector<BlockOffsets> down, up;
    std::optional<BlockOffsets> query;  ///< attention: query, key, value
    ConvOffsets project;                ///< attention: projection of the result
    std::size_t n_parameters = 0, n_running = 0;

    explicit UnetLayout(const RayDropNetwork& network);

private:
    ConvOffsets add_conv(std::uint32_t n_in, std::uint32_t n_out, std::uint32_t taps);
    ConvOffsets add_biased_conv(std::uint32_t n_in, std::uint32_t n_out);
    BlockOffsets add_block(std::uint32_t n_in, std::uint32_t n_out, std::uint32_t taps);
};

/// These functions count the channels of a decoder level: of its output, of its upsampled
/// input, and of this input together with the skip connection.
std::uint32_t decoder_channels(const std::vector<std::uint32_t>& widths, std::size_t level);
std::uint32_t upsampled_channels(const std::vector<std::uint32_t>& widths, std::size_t level);
std::uint32_t joined_channels(const std::vector<std::uint32_t>& widths, std::size_t level);

/// Initialises the parameters of a network for training. If the network is residual, its
/// last convolution starts at 0, so that its first output is 0.
/// @param seed seed of the random weights
void init_parameters(RayDropNetwork& network, const UnetLayout& layout, std::uint64_t seed);

class Unet {
public:
    Unet(Device& device, const RayDropNetwork& network);

    /// Allocates all arrays for images of one size, unless they already exist.
    /// @param grid number and size of the images of a batch
    /// @param with_gradients true: also allocates memory for backward()
    void allocate(Device& device, ImageBatchSize grid, bool with_gradients);
    /// Computes the logits of a training batch.
    /// @param dropout_key key of the random numbers that select the dropped values
    void forward(Stream& stream, std::uint32_t dropout_key, float dropout_rate);
    /// Uses the running mean and variance, and no dropout.
    void run_inference(Stream& stream);
    /// Computes the gradients of all parameters from d_logits(), which the caller writes
    /// after forward().
    void backward(Stream& stream);

    /// No pending command on the device may use the old values.
    void set_parameters(const std::vector<float>& parameters, const std::vector<float>& running_moments) {
        parameters_.upload(parameters);
        running_.upload(running_moments);
    }

    const Tensor& input_images() const { return inputs_; }  ///< Input images, which the caller fills.
    const Tensor& logits() const { return logit_; }
    /// Gradient of the logits, which the caller writes.
    const Tensor& d_logits() const { return d_logit_; }
    const Array<float>& parameters() const { return parameters_; }
    const Array<float>& gradients() const { return gradients_; }
    const Array<float>& running_moments() const { return running_; }

private:
    /// Results of a block that the backward pass needs.
    struct BlockState {
        Tensor active;
        NormState norm;
    };
    /// Arrays of one level of the U-Net. `joined`: upsampled images and skip connection.
    /// `between`: images between the two blocks of a level.
    struct LevelBuffers {
        Tensor joined, d_joined, down_between, d_down_between, up_between, d_up_between, up, d_up, pooled,
            d_pooled;
    };
    enum class Mode { train, evaluate };

    UnetLayout plan_;
    std::vector<std::uint32_t> widths_;
    bool with_gradients_ = false;
    Convolution conv1_, conv3_;
    Norm norm_;
    Resampling resample_;
    std::optional<Attention> attention_;
    Array<float> parameters_, gradients_, running_;
    Tensor inputs_, logit_, d_logit_;
    Tensor qkv_, d_qkv_, attended_, d_attended_, mixed_, d_mixed_;
    AttentionState attention_state_;
    BlockState query_state_;
    std::vector<LevelBuffers> levels_;
    std::vector<BlockState> down_states_, up_states_;
    std::size_t most_active_ = 0;  ///< largest number of activations after a normalisation in any block
    Tensor scratch_;               ///< gradients of these activations

    Convolution::Weights conv_weights(std::size_t offset) const {
        return parameters_.address_as<float, shared::ConvWeights>(offset);
    }
    Convolution& conv_kernels(const ConvOffsets& layer) { return layer.taps == 1 ? conv1_ : conv3_; }
    /// Runs a 1x1 convolution with a bias.
    void run_biased_conv(Stream& stream, const ConvOffsets& layer, const Slice& in, const Slice& out,
                         bool add = false) {
        conv1_.run_convolution(stream, in, conv_weights(layer.weights),
                               parameters_.address_as<float, shared::ConvBias>(*layer.bias), out, add);
    }
    std::size_t smallest_level() const { return widths_.size() - 1; }
    std::size_t n_decoder_levels() const { return plan_.up.size() / 2; }
    // Indices of the two blocks of a level in UnetLayout::down and up. Level 0 has no
    // encoder blocks.
    static std::array<std::size_t, 2> encoder_blocks(std::size_t level) {
        return {2 * level - 2, 2 * level - 1};
    }
    static std::array<std::size_t, 2> decoder_blocks(std::size_t level) { return {2 * level, 2 * level + 1}; }
    /// Channels of `joined` that the encoder writes and the decoder reads (skip
    /// connection).
    Slice skip(std::size_t level) const;
    Slice d_skip(std::size_t level) const;
    void allocate_level(Device& device, std::size_t level, ImageBatchSize grid);
    void allocate_attention(Device& device);
    void allocate_block(Device& device, const BlockOffsets& block, ImageBatchSize grid, BlockState& state);
    void run_conv_block(Stream& stream, const BlockOffsets& block, BlockState& state, const Slice& in,
                        const Slice& out, Mode mode);
    void block_vjp(Stream& stream, const BlockOffsets& block, BlockState& state, const Slice& in,
                   const Slice& d_out, const Slice& d_in, bool add = false);
    void conv_vjp(Stream& stream, const ConvOffsets& layer, const Slice& input, const Slice& d_out);
    void run_all_layers(Stream& stream, Mode mode);
    void encode_level(Stream& stream, std::size_t level, Mode mode);
    void encode_vjp(Stream& stream, std::size_t level);
    void decode_level(Stream& stream, std::size_t level, Mode mode);
    void decode_vjp(Stream& stream, std::size_t level);
    void run_attention(Stream& stream, Mode mode);
    void attention_vjp(Stream& stream);
};

}  // namespace relidar::network
