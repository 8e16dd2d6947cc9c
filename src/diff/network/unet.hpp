// SPDX-License-Identifier: Apache-2.0
// Implements the ray-drop network as a U-Net (Ronneberger et al.). Each level has two
// blocks of [normalisation, ReLU, dropout, convolution] and a skip connection. The
// smallest size also has attention. Stores the parameters and runs passes over images of
// one size.
#pragma once

#include <optional>
#include <vector>

#include <relidar/diff/network.hpp>

#include "diff/network/attention.hpp"
#include "diff/network/conv.hpp"
#include "diff/network/norm.hpp"
#include "diff/network/resample.hpp"

namespace relidar::refine {

/// Offsets of a convolution's parameters in the parameter array.
struct ConvLayer {
    std::uint32_t n_in = 0, n_out = 0, taps = 1;
    std::size_t weights = 0;
    std::optional<std::size_t> bias = {};
};

/// Where the parameters of a block are stored. A block is normalisation, ReLU, dropout,
/// convolution.
struct Block {
    std::size_t beta_gamma = 0, running = 0;
    ConvLayer conv;
};

/// Offsets of all parameters of a network.
struct UnetPlan {
    /// First convolution (`head`), from the inputs to the channels of the first level,
    /// and last convolution (`tail`), from these channels to a logit.
    ConvLayer head, tail;
    /// Blocks of the encoder (`down`) and of the decoder (`up`), two per level. Both
    /// lists begin at full image size.
    std::vector<Block> down, up;
    std::optional<Block> query;  ///< attention: query, key, value
    ConvLayer project;           ///< attention: projection of the result
    std::size_t n_parameters = 0, n_running = 0;

    explicit UnetPlan(const DropNetwork& network);
};

/// Channels at a level of the decoder. count_decoder_channels(): output.
/// count_channels_below(): input from the smaller images. count_concatenated_channels():
/// this input and the skip connection together.
std::uint32_t count_decoder_channels(const std::vector<std::uint32_t>& widths, std::size_t level);
std::uint32_t count_channels_below(const std::vector<std::uint32_t>& widths, std::size_t level);
std::uint32_t count_concatenated_channels(const std::vector<std::uint32_t>& widths, std::size_t level);

/// Initialises the parameters with Kaiming's uniform distribution. Normalisations start
/// with gamma 1 and beta 0. If the network predicts a correction, its last convolution
/// starts with 0, so that it initially corrects nothing.
void initialise(DropNetwork& network, const UnetPlan& plan, std::uint64_t seed);

/// Network on a device, with its parameters and memory.
class Unet {
public:
    Unet(Device& device, const DropNetwork& network);

    /// Allocates memory for passes over images of one size.
    /// @param with_gradients true: also allocates memory for backward()
    void reserve(Device& device, const Grid& grid, bool with_gradients);
    /// Submits a forward pass for training.
    /// @param dropout_key random key for the dropout masks of this step
    void forward(Stream& stream, std::uint32_t dropout_key, float dropout);
    /// Submits a forward pass for inference. Uses the running mean and variance, and no
    /// dropout.
    void evaluate(Stream& stream);
    /// Submits the backward pass that follows forward(). Computes the gradients of all
    /// parameters. Before, the caller must write the gradient of the logits to d_logit().
    void backward(Stream& stream);

    /// Replaces all parameters of the network. Their number must not change. No pending
    /// command on the device may use the old values.
    void upload(const std::vector<float>& parameters, const std::vector<float>& running) {
        parameters_.upload(parameters);
        running_.upload(running);
    }

    const Tensor& inputs() const { return inputs_; }  ///< Input images, which the caller fills.
    const Tensor& logit() const { return logit_; }
    /// Gradient of the logits, which the caller fills.
    const Tensor& d_logit() const { return d_logit_; }
    const Array<float>& parameters() const { return parameters_; }
    const Array<float>& gradients() const { return gradients_; }
    const Array<float>& running() const { return running_; }

private:
    /// Results that the forward pass stores for the backward pass of a block: activations
    /// after the normalisation, and intermediate values of the normalisation.
    struct BlockState {
        Tensor active;
        NormState norm;
    };
    /// Arrays of one image size: the input of the decoder [smaller images, skip
    /// connection], the images between two blocks, and their gradients.
    struct Level {
        Tensor joined, d_joined, down_between, d_down_between, up_between, d_up_between, up, d_up, pooled,
            d_pooled;
    };
    enum class Mode { train, evaluate };

    UnetPlan plan_;
    std::vector<std::uint32_t> widths_;
    bool with_gradients_ = false;
    Conv conv1_, conv3_;
    Norm norm_;
    Resample resample_;
    std::optional<Attention> attention_;
    Array<float> parameters_, gradients_, running_;
    Tensor inputs_, logit_, d_logit_;
    Tensor qkv_, d_qkv_, attended_, d_attended_, mixed_, d_mixed_;
    AttentionState attention_state_;
    BlockState query_state_;
    std::vector<Level> levels_;
    std::vector<BlockState> down_states_, up_states_;
    std::size_t most_active_ = 0;  ///< largest number of activations after a normalisation in any block
    Tensor scratch_;               ///< gradients of these activations

    Conv::Weights weights(std::size_t first) const {
        return parameters_.address_as<float, shared::ConvWeights>(first);
    }
    Conv::Bias bias(std::size_t first) const {
        return parameters_.address_as<float, shared::ConvBias>(first);
    }
    Conv& get_conv(const ConvLayer& layer) { return layer.taps == 1 ? conv1_ : conv3_; }
    Slice skip(std::size_t level) const;
    Slice d_skip(std::size_t level) const;
    void reserve_level(Device& device, std::size_t level, const Grid& grid);
    void reserve_attention(Device& device);
    void reserve_block(Device& device, const Block& block, const Grid& grid, BlockState& state);
    void run_block(Stream& stream, const Block& block, BlockState& state, const Slice& input,
                   const Slice& output, Mode mode);
    void backpropagate_block(Stream& stream, const Block& block, BlockState& state, const Slice& input,
                             const Slice& d_to, const Slice& d_from, bool accumulate = false);
    void backpropagate_conv(Stream& stream, const ConvLayer& layer, const Slice& input, const Slice& d_to);
    void run(Stream& stream, Mode mode);
    void attend(Stream& stream, Mode mode);
    void backpropagate_attention(Stream& stream);
};

}  // namespace relidar::refine
