// SPDX-License-Identifier: Apache-2.0
// The ray-drop network: a U-Net (Ronneberger et al.) with two blocks of [normalisation,
// ReLU, dropout, convolution] per level, attention at the smallest size, and skip
// connections. Holds its parameters and passes over images of one size.
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

/// Offsets of a block: normalisation, ReLU, dropout, convolution.
struct Block {
    std::size_t beta_gamma = 0, running = 0;
    ConvLayer conv;
};

/// Offsets of all parameters of a network.
struct UnetPlan {
    /// First and last convolution: `head` converts the inputs to full-size channels,
    /// `tail` converts these channels to a logit.
    ConvLayer head, tail;
    /// Blocks of the encoder (`down`) and the decoder (`up`), two per level. `up` starts
    /// at full size.
    std::vector<Block> down, up;
    std::optional<Block> query;  ///< attention: query, key, value
    ConvLayer project;           ///< attention: projection of the result
    std::size_t n_parameters = 0, n_running = 0;

    explicit UnetPlan(const DropNetwork& network);
};

/// Return the number of channels at a level: the output of the decoder, the input from
/// the next smaller images, and the sum of that input and the skip connection.
std::uint32_t up_channels(const std::vector<std::uint32_t>& widths, std::size_t level);
std::uint32_t below_channels(const std::vector<std::uint32_t>& widths, std::size_t level);
std::uint32_t count_joined_channels(const std::vector<std::uint32_t>& widths, std::size_t level);

/// Initialises the parameters: Kaiming's uniform distribution, norms with gamma 1 and
/// beta 0. The last convolution of a residual network is 0, so that the network initially
/// changes nothing.
void initialise(DropNetwork& network, const UnetPlan& plan, std::uint64_t seed);

/// A network on a device.
class Unet {
public:
    Unet(Device& device, const DropNetwork& network);

    /// Allocates memory for passes over images of one size.
    /// @param with_gradients  true: also allocates memory for backward()
    void reserve(Device& device, const Grid& grid, bool with_gradients);
    /// Submits a forward pass in training mode.
    /// @param dropout_key  random key of this step's dropout masks
    void forward(Stream& stream, std::uint32_t dropout_key, float dropout);
    /// Submits a forward pass for inference, with running mean and variance and without
    /// dropout.
    void evaluate(Stream& stream);
    /// Submits the backward pass of forward(). Computes dL/d(parameters) from dL/d(logit)
    /// in d_logit().
    void backward(Stream& stream);

    /// Replaces all parameters of the network. The sizes must match. No command on the
    /// device may still use the old values.
    void upload(const std::vector<float>& parameters, const std::vector<float>& running) {
        parameters_.upload(parameters);
        running_.upload(running);
    }

    const Tensor& inputs() const { return inputs_; }  ///< the caller fills it
    const Tensor& logit() const { return logit_; }
    const Tensor& d_logit() const { return d_logit_; }  ///< the caller fills it
    const Array<float>& parameters() const { return parameters_; }
    const Array<float>& gradients() const { return gradients_; }
    const Array<float>& running() const { return running_; }

private:
    /// Activations of a block after the normalisation.
    struct BlockState {
        Tensor active;
        NormState norm;
    };
    /// Arrays of one image size: the joined input [from below, skip], the images between
    /// two blocks, and their gradients.
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
    std::size_t most_active_ = 0;  ///< activations after a norm in the largest block
    Tensor scratch_;               ///< gradients of these activations

    Conv::Weights weights(std::size_t first) const {
        return parameters_.address_as<float, shared::ConvWeights>(first);
    }
    Conv::Bias bias(std::size_t first) const {
        return parameters_.address_as<float, shared::ConvBias>(first);
    }
    Conv& conv_of(const ConvLayer& layer) { return layer.taps == 1 ? conv1_ : conv3_; }
    Slice skip(std::size_t level) const;
    Slice d_skip(std::size_t level) const;
    void reserve_level(Device& device, std::size_t level, const Grid& grid);
    void reserve_attention(Device& device);
    void reserve_block(Device& device, const Block& block, const Grid& grid, BlockState& state);
    void run_block(Stream& stream, const Block& block, BlockState& state, const Slice& from, const Slice& to,
                   Mode mode);
    void block_vjp(Stream& stream, const Block& block, BlockState& state, const Slice& from,
                   const Slice& d_to, const Slice& d_from, bool accumulate = false);
    void conv_vjp(Stream& stream, const ConvLayer& layer, const Slice& from, const Slice& d_to);
    void run(Stream& stream, Mode mode);
    void attend(Stream& stream, Mode mode);
    void attend_vjp(Stream& stream);
};

}  // namespace relidar::refine
