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

using BlockPair = std::array<BlockOffsets, 2>;

struct UnetLayout {
    /// `first_conv` converts the inputs to the channels of the first level. `last_conv`
    /// converts these channels to a logit.
    ConvOffsets first_conv, last_conv;
    /// Two blocks per level of the encoder (from level 1, half the image size) and of the
    /// decoder (from level 0, the full image size).
    std::vector<BlockPair> down, up;
    /// Number of channels that each decoder level reads from the level below it. Its
    /// other input channels are the skip connection.
    std::vector<std::uint32_t> n_upsampled;
    std::optional<BlockOffsets> query;  ///< attention: query, key, value
    ConvOffsets project;                ///< attention: projection of the result
    std::size_t n_parameters = 0, n_running = 0;

    explicit UnetLayout(const RayDropNetwork& network);

private:
    ConvOffsets add_conv(std::uint32_t n_in, std::uint32_t n_out, std::uint32_t taps);
    ConvOffsets add_biased_conv(std::uint32_t n_in, std::uint32_t n_out);
    BlockOffsets add_block(std::uint32_t n_in, std::uint32_t n_out, std::uint32_t taps);
};

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
    const Tensor& logits() const { return logit_.values; }
    /// Gradient of the logits, which the caller writes.
    const Tensor& d_logits() const { return logit_.gradient; }
    const Array<float>& parameters() const { return parameters_; }
    const Array<float>& gradients() const { return gradients_; }
    const Array<float>& running_moments() const { return running_; }

private:
    /// Images, and the gradient of the loss with respect to them.
    struct Activation {
        Tensor values;
        Tensor gradient;  ///< empty without gradients
    };
    /// Results of a block that the backward pass needs.
    struct BlockState {
        Tensor active;
        NormState norm;
    };
    struct BlockPairState {
        std::array<BlockState, 2> blocks;
        Activation between;  ///< output of the first block, input of the second
    };
    struct LevelImages {
        Activation pooled;  ///< input of the encoder: halved images of the level above
        Activation joined;  ///< input of the decoder: enlarged images of the level below, skip connection
        Activation output;  ///< of the decoder or, at the smallest level, of the encoder
    };
    enum class Mode { train, evaluate };

    UnetLayout plan_;
    bool with_gradients_ = false;
    Convolution conv1_, conv3_;
    Norm norm_;
    Resampling resample_;
    std::optional<Attention> attention_;
    Array<float> parameters_, gradients_, running_;
    Tensor inputs_;
    std::vector<LevelImages> levels_;
    std::vector<BlockPairState> encoders_, decoders_;  ///< like UnetLayout::down and up
    BlockState query_state_;
    AttentionState attention_state_;
    /// Attention: queries, keys and values; its result; its result added to its input.
    Activation qkv_, attended_, mixed_;
    Activation logit_;
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
    std::size_t smallest_level() const { return plan_.down.size(); }
    /// Channels that the encoder writes and the decoder reads (skip connection).
    Slice skip_part(const Tensor& joined, std::size_t level) const;
    Slice skip(std::size_t level) const { return skip_part(levels_[level].joined.values, level); }
    Slice d_skip(std::size_t level) const { return skip_part(levels_[level].joined.gradient, level); }
    const Activation& level_below(std::size_t level) const;
    Activation make_images(Device& device, std::uint32_t channels, ImageBatchSize grid,
                           const std::string& text) const;
    void allocate_level(Device& device, std::size_t level, ImageBatchSize grid);
    void allocate_attention(Device& device);
    void allocate_pair(Device& device, const BlockPair& blocks, ImageBatchSize grid, BlockPairState& state);
    void allocate_block(Device& device, const BlockOffsets& block, ImageBatchSize grid, BlockState& state);
    void reserve_vjp_sums(Device& device, const ConvOffsets& layer, ImageBatchSize grid);
    void run_block(Stream& stream, const BlockOffsets& block, BlockState& state, const Slice& in,
                   const Slice& out, Mode mode);
    void run_pair(Stream& stream, const BlockPair& blocks, BlockPairState& state, const Slice& in,
                  const Slice& out, Mode mode);
    void block_vjp(Stream& stream, const BlockOffsets& block, BlockState& state, const Slice& in,
                   const Slice& d_out, const Slice& d_in, bool add = false);
    void pair_vjp(Stream& stream, const BlockPair& blocks, BlockPairState& state, const Slice& in,
                  const Slice& d_out, const Slice& d_in);
    void conv_vjp(Stream& stream, const ConvOffsets& layer, const Slice& in, const Slice& d_out,
                  const std::optional<Slice>& d_in);
    void run_all_layers(Stream& stream, Mode mode);
    void encode_level(Stream& stream, std::size_t level, Mode mode);
    void encode_vjp(Stream& stream, std::size_t level);
    void decode_level(Stream& stream, std::size_t level, Mode mode);
    void decode_vjp(Stream& stream, std::size_t level);
    void run_attention(Stream& stream, Mode mode);
    void attention_vjp(Stream& stream);
};

}  // namespace relidar::network
