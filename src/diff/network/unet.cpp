// SPDX-License-Identifier: Apache-2.0
// Forward and backward passes of the U-Net. Each encoder block writes its output directly
// into some channels of the tensor that the decoder reads. Therefore the skip connection
// needs no copy. In the backward pass, these channels keep the gradient of the skip
// connection until the gradient from the smaller image size is added.
#include "diff/network/unet.hpp"

#include <algorithm>

namespace relidar::network {

Unet::Unet(Device& device, const RayDropNetwork& network)
    : plan_(network),
      widths_(network.widths),
      conv1_(device, 1),
      conv3_(device, 9),
      norm_(device),
      resample_(device),
      parameters_(device, network.parameters, "network parameters"),
      running_(device, network.running, "running moments") {
    if (network.heads > 0) attention_.emplace(device, network.heads);
}

Slice Unet::skip(std::size_t level) const {
    return levels_[level].joined.channel_range(upsampled_channels(widths_, level), widths_[level]);
}

Slice Unet::d_skip(std::size_t level) const {
    return levels_[level].d_joined.channel_range(upsampled_channels(widths_, level), widths_[level]);
}

/// Allocates the results of a block that the backward pass needs, and temporary sums.
void Unet::allocate_block(Device& device, const BlockOffsets& block, ImageBatchSize grid, BlockState& state) {
    state.active = Tensor(device, block.conv.n_in, grid, "activations");
    state.norm = NormState(device, block.conv.n_in);
    norm_.reserve_sums(block.conv.n_in, grid);
    if (!with_gradients_) return;
    most_active_ = std::max(most_active_, block.conv.n_in * grid.n_pixels_total());
    Convolution& conv = conv_kernels(block.conv);
    conv.reserve_weight_sums(device, conv.n_partial_sums(grid, block.conv.n_in, block.conv.n_out));
}

/// Allocates the images of one level and, if requested, their gradients. `grid` is the
/// image size of the level. The first level has no encoder blocks, the last no decoder
/// blocks. `pooled` is the halved output of the level above, `joined` the enlarged output
/// of the level below with the skip connection, `*_between` the output of a first block.
void Unet::allocate_level(Device& device, std::size_t level, ImageBatchSize grid) {
    LevelBuffers& l = levels_[level];
    const auto allocate_images = [&](Tensor& values, Tensor& gradients, std::uint32_t channels) {
        values = Tensor(device, channels, grid, "activations");
        if (with_gradients_) gradients = Tensor(device, channels, grid, "gradients of activations");
    };
    if (level > 0) {
        allocate_images(l.pooled, l.d_pooled, widths_[level - 1]);
        allocate_images(l.down_between, l.d_down_between, widths_[level]);
        for (const std::size_t block : encoder_blocks(level))
            allocate_block(device, plan_.down[block], grid, down_states_[block]);
    }
    const bool has_decoder = 2 * level < plan_.up.size();
    if (!has_decoder) {
        allocate_images(l.up, l.d_up, widths_[level]);
        return;
    }
    allocate_images(l.joined, l.d_joined, joined_channels(widths_, level));
    allocate_images(l.up_between, l.d_up_between, joined_channels(widths_, level));
    allocate_images(l.up, l.d_up, decoder_channels(widths_, level));
    for (const std::size_t block : decoder_blocks(level))
        allocate_block(device, plan_.up[block], grid, up_states_[block]);
}

void Unet::allocate(Device& device, ImageBatchSize grid, bool with_gradients) {
    const bool has_gradients = with_gradients_ || !with_gradients;
    if (inputs_.grid == grid && has_gradients) return;
    with_gradients_ = with_gradients;
    most_active_ = 0;
    // Frees the old arrays before it allocates new arrays, because the memory may be too
    // small for both.
    levels_.clear();
    levels_.resize(widths_.size());
    down_states_.resize(plan_.down.size());
    up_states_.resize(plan_.up.size());
    inputs_ = Tensor(device, plan_.first_conv.n_in, grid, "network inputs");
    logit_ = Tensor(device, 1, grid, "drop logits");
    if (with_gradients) d_logit_ = Tensor(device, 1, grid, "gradient of drop logits");
    if (with_gradients) gradients_.reserve(device, parameters_.size(), "gradients of the network");
    ImageBatchSize level_grid = grid;
    for (std::size_t level = 0; level < levels_.size(); ++level) {
        allocate_level(device, level, level_grid);
        level_grid = half_size(level_grid);
    }
    for (const ConvOffsets* layer : {&plan_.first_conv, &plan_.last_conv})
        conv1_.reserve_weight_sums(device, conv1_.n_partial_sums(grid, layer->n_in, layer->n_out));
    norm_.reserve_sums(1, grid);
    norm_.reserve_sums(widths_[0], grid);
    if (attention_) allocate_attention(device);
    if (with_gradients)
        scratch_ = Tensor(device, 1, {1, 1, std::uint32_t(most_active_)}, "gradient of activations");
}

/// Allocates the arrays of the attention, which works on the smallest images.
void Unet::allocate_attention(Device& device) {
    const ImageBatchSize& smallest = levels_.back().up.grid;
    const std::uint32_t channels = widths_.back();
    allocate_block(device, *plan_.query, smallest, query_state_);
    qkv_ = Tensor(device, 3 * channels, smallest, "queries, keys and values");
    attended_ = Tensor(device, channels, smallest, "attention");
    mixed_ = Tensor(device, channels, smallest, "attention added");
    attention_state_ = attention_->allocate_state(smallest, with_gradients_);
    conv1_.reserve_weight_sums(device, conv1_.n_partial_sums(smallest, channels, channels));
    if (!with_gradients_) return;
    d_qkv_ = Tensor(device, 3 * channels, smallest, "gradient of queries");
    d_attended_ = Tensor(device, channels, smallest, "gradient of attention");
    d_mixed_ = Tensor(device, channels, smallest, "gradient of attention added");
}

/// Runs a block: normalisation, ReLU, dropout (only in training), convolution.
/// @param state receives the results that the backward pass needs
void Unet::run_conv_block(Stream& stream, const BlockOffsets& block, BlockState& state, const Slice& in,
                          const Slice& out, Mode mode) {
    const NormWeights norm_weights{parameters_.address_as<glm::vec2, shared::BetaGamma>(block.beta_gamma),
                                   running_.address_as<glm::vec2, shared::RunningMoments>(block.running)};
    if (mode == Mode::train) norm_.normalise_batch(stream, in, norm_weights, state.norm, state.active);
    else norm_.normalise(stream, in, norm_weights, state.norm, state.active);
    conv_kernels(block.conv).run_convolution(stream, state.active, conv_weights(block.conv.weights), {}, out);
}

/// Writes the smallest images plus their self-attention to `mixed_`.
void Unet::run_attention(Stream& stream, Mode mode) {
    const Tensor& bottom = levels_.back().up;
    run_conv_block(stream, *plan_.query, query_state_, bottom, qkv_, mode);
    attention_->attend(stream, qkv_, attention_state_, attended_);
    stream.copy(bottom.values.buffer(), mixed_.values.buffer(), bottom.values.size() * sizeof(float));
    const bool add = true;  // residual connection
    run_biased_conv(stream, plan_.project, attended_, mixed_, add);
}

/// Halves the images of the level above, and runs both encoder blocks. Writes the result
/// to the skip connection or, at the smallest level, to `up`.
void Unet::encode_level(Stream& stream, std::size_t level, Mode mode) {
    const LevelBuffers& l = levels_[level];
    const auto [first, second] = encoder_blocks(level);
    const Slice output = level < smallest_level() ? skip(level) : l.up;
    resample_.max_pool(stream, skip(level - 1), l.pooled);
    run_conv_block(stream, plan_.down[first], down_states_[first], l.pooled, l.down_between, mode);
    run_conv_block(stream, plan_.down[second], down_states_[second], l.down_between, output, mode);
}

/// Joins the enlarged images of the level below with the skip connection, and runs both
/// decoder blocks.
void Unet::decode_level(Stream& stream, std::size_t level, Mode mode) {
    const LevelBuffers& l = levels_[level];
    const auto [first, second] = decoder_blocks(level);
    // A network with one level has no level below.
    if (const std::uint32_t n_upsampled = upsampled_channels(widths_, level); n_upsampled > 0) {
        const bool reads_attention = attention_ && level + 1 == smallest_level();
        resample_.upsample(stream, reads_attention ? mixed_ : levels_[level + 1].up,
                           l.joined.channel_range(0, n_upsampled));
    }
    run_conv_block(stream, plan_.up[first], up_states_[first], l.joined, l.up_between, mode);
    run_conv_block(stream, plan_.up[second], up_states_[second], l.up_between, l.up, mode);
}

/// Computes the logits of the input images: encoder from the full image size to the
/// smallest, attention, and decoder back to the full size.
void Unet::run_all_layers(Stream& stream, Mode mode) {
    run_biased_conv(stream, plan_.first_conv, inputs_, skip(0));
    for (std::size_t level = 1; level <= smallest_level(); ++level) encode_level(stream, level, mode);
    if (attention_) run_attention(stream, mode);
    for (std::size_t level = n_decoder_levels(); level-- > 0;) decode_level(stream, level, mode);
    run_biased_conv(stream, plan_.last_conv, levels_[0].up, logit_);
}

void Unet::forward(Stream& stream, std::uint32_t dropout_key, float dropout_rate) {
    // Each block drops other values.
    std::uint32_t key = dropout_key;
    for (std::vector<BlockState>* states : {&down_states_, &up_states_})
        for (BlockState& state : *states) {
            state.norm.dropout_key = key++;
            state.norm.dropout = dropout_rate;
        }
    run_all_layers(stream, Mode::train);
}

void Unet::run_inference(Stream& stream) { run_all_layers(stream, Mode::evaluate); }

/// Computes the gradients of the weights and the bias of a convolution.
void Unet::conv_vjp(Stream& stream, const ConvOffsets& layer, const Slice& input, const Slice& d_out) {
    conv_kernels(layer).weights_vjp(stream, input, d_out,
                                    gradients_.address_as<float, shared::ConvWeights>(layer.weights));
    if (layer.bias)
        norm_.bias_vjp(stream, d_out, gradients_.address_as<float, shared::ConvBias>(*layer.bias));
}

/// Backward pass of run_conv_block(): gradients of the parameters and of the input.
/// @param add true: adds the gradient of the input to `d_in` instead of overwriting it
void Unet::block_vjp(Stream& stream, const BlockOffsets& block, BlockState& state, const Slice& in,
                     const Slice& d_out, const Slice& d_in, bool add) {
    const ConvOffsets& conv = block.conv;
    const Slice d_active{{scratch_.values.address(), conv.n_in, 0}, conv.n_in, in.grid};
    conv_vjp(stream, conv, state.active, d_out);
    conv_kernels(conv).input_vjp(stream, d_out, conv_weights(conv.weights), d_active);
    norm_.norm_vjp(stream, in, state.norm, d_active, d_in, {gradients_, block.beta_gamma}, add);
}

/// Backward pass of run_attention(). The residual connection passes on `d_mixed_`
/// unchanged, and the gradient through the attention is added to it.
void Unet::attention_vjp(Stream& stream) {
    const LevelBuffers& smallest = levels_.back();
    conv_vjp(stream, plan_.project, attended_, d_mixed_);
    conv1_.input_vjp(stream, d_mixed_, conv_weights(plan_.project.weights), d_attended_);
    attention_->attend_vjp(stream, qkv_, attention_state_, d_attended_, d_qkv_);
    stream.copy(d_mixed_.values.buffer(), smallest.d_up.values.buffer(),
                d_mixed_.values.size() * sizeof(float));
    const bool add = true;
    block_vjp(stream, *plan_.query, query_state_, smallest.up, d_qkv_, smallest.d_up, add);
}

/// Backward pass of decode_level(). The gradient of `joined` contains the gradient of the
/// skip connection, which encode_vjp() of the same level uses.
void Unet::decode_vjp(Stream& stream, std::size_t level) {
    const LevelBuffers& l = levels_[level];
    const auto [first, second] = decoder_blocks(level);
    block_vjp(stream, plan_.up[second], up_states_[second], l.up_between, l.d_up, l.d_up_between);
    block_vjp(stream, plan_.up[first], up_states_[first], l.joined, l.d_up_between, l.d_joined);
    if (const std::uint32_t n_upsampled = upsampled_channels(widths_, level); n_upsampled > 0) {
        const bool reads_attention = attention_ && level + 1 == smallest_level();
        resample_.upsample_vjp(stream, l.d_joined.channel_range(0, n_upsampled),
                               reads_attention ? d_mixed_ : levels_[level + 1].d_up);
    }
}

/// Backward pass of encode_level(). Adds to the gradient that the skip connection of the
/// level above got from the decoder.
void Unet::encode_vjp(Stream& stream, std::size_t level) {
    const LevelBuffers& l = levels_[level];
    const auto [first, second] = encoder_blocks(level);
    const Slice d_output = level < smallest_level() ? d_skip(level) : l.d_up;
    block_vjp(stream, plan_.down[second], down_states_[second], l.down_between, d_output, l.d_down_between);
    block_vjp(stream, plan_.down[first], down_states_[first], l.pooled, l.d_down_between, l.d_pooled);
    resample_.max_pool_vjp(stream, skip(level - 1), l.d_pooled, d_skip(level - 1));
}

void Unet::backward(Stream& stream) {
    // Processes all layers of run_all_layers() in reverse order.
    conv_vjp(stream, plan_.last_conv, levels_[0].up, d_logit_);
    conv1_.input_vjp(stream, d_logit_, conv_weights(plan_.last_conv.weights), levels_[0].d_up);
    for (std::size_t level = 0; level < n_decoder_levels(); ++level) decode_vjp(stream, level);
    if (attention_) attention_vjp(stream);
    for (std::size_t level = smallest_level(); level > 0; --level) encode_vjp(stream, level);
    conv_vjp(stream, plan_.first_conv, inputs_, d_skip(0));
}

}  // namespace relidar::network
