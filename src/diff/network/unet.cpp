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

void Unet::allocate_block(Device& device, const BlockOffsets& block, ImageBatchSize grid, BlockState& state) {
    state.active = Tensor(device, block.conv.n_in, grid, "activations");
    state.norm = NormState(device, block.conv.n_in);
    norm_.reserve_sums(block.conv.n_in, grid);
    if (!with_gradients_) return;
    most_active_ = std::max(most_active_, block.conv.n_in * grid.n_pixels_total());
    Convolution& conv = conv_kernels(block.conv);
    conv.reserve_weight_sums(device, conv.n_partial_sums(grid, block.conv.n_in, block.conv.n_out));
}

void Unet::allocate_level(Device& device, std::size_t level, ImageBatchSize grid) {
    LevelBuffers& l = levels_[level];
    const auto tensors = [&](Tensor& values, Tensor& gradients, std::uint32_t channels, ImageBatchSize of) {
        values = Tensor(device, channels, of, "activations");
        if (with_gradients_) gradients = Tensor(device, channels, of, "gradients of activations");
    };
    // Level l has the encoder blocks 2 l - 2 and 2 l - 1, and the decoder blocks 2 l
    // and 2 l + 1.
    if (level > 0) {
        tensors(l.pooled, l.d_pooled, widths_[level - 1], grid);
        tensors(l.down_between, l.d_down_between, widths_[level], grid);
        for (std::size_t k = 0; k < 2; ++k)
            allocate_block(device, plan_.down[2 * level - 2 + k], grid, down_states_[2 * level - 2 + k]);
    }
    if (2 * level >= plan_.up.size()) {  // smallest image size
        tensors(l.up, l.d_up, widths_[level], grid);
        return;
    }
    tensors(l.joined, l.d_joined, joined_channels(widths_, level), grid);
    tensors(l.up_between, l.d_up_between, joined_channels(widths_, level), grid);
    tensors(l.up, l.d_up, decoder_channels(widths_, level), grid);
    for (std::size_t k = 0; k < 2; ++k)
        allocate_block(device, plan_.up[2 * level + k], grid, up_states_[2 * level + k]);
}

void Unet::allocate(Device& device, ImageBatchSize grid, bool with_gradients) {
    if (inputs_.grid == grid && (with_gradients_ || !with_gradients)) return;
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
    ImageBatchSize at = grid;
    for (std::size_t level = 0; level < levels_.size(); ++level, at = half_size(at))
        allocate_level(device, level, at);
    for (const ConvOffsets* layer : {&plan_.first_conv, &plan_.last_conv})
        conv1_.reserve_weight_sums(device, conv1_.n_partial_sums(grid, layer->n_in, layer->n_out));
    norm_.reserve_sums(1, grid);
    norm_.reserve_sums(widths_[0], grid);
    if (attention_) allocate_attention(device);
    if (with_gradients)
        scratch_ = Tensor(device, 1, {1, 1, std::uint32_t(most_active_)}, "gradient of activations");
}

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

void Unet::run_conv_block(Stream& s, const BlockOffsets& b, BlockState& a, const Slice& in, const Slice& out,
                          Mode mode) {
    const NormWeights norm_weights{parameters_.address_as<glm::vec2, shared::BetaGamma>(b.beta_gamma),
                                   running_.address_as<glm::vec2, shared::RunningMoments>(b.running)};
    if (mode == Mode::train) norm_.normalise_batch(s, in, norm_weights, a.norm, a.active);
    else norm_.normalise(s, in, norm_weights, a.norm, a.active);
    conv_kernels(b.conv).run_convolution(s, a.active, conv_weights(b.conv.weights), {}, out);
}

void Unet::run_attention(Stream& stream, Mode mode) {
    const Tensor& bottom = levels_.back().up;
    run_conv_block(stream, *plan_.query, query_state_, bottom, qkv_, mode);
    attention_->attend(stream, qkv_, attention_state_, attended_);
    stream.copy(bottom.values.buffer(), mixed_.values.buffer(), bottom.values.size() * sizeof(float));
    conv1_.run_convolution(stream, attended_, conv_weights(plan_.project.weights),
                           conv_bias(*plan_.project.bias), mixed_, true);
}

void Unet::run_all_layers(Stream& stream, Mode mode) {
    // The encoder writes each level except the smallest into `joined` (skip
    // connection).
    conv1_.run_convolution(stream, inputs_, conv_weights(plan_.first_conv.weights),
                           conv_bias(*plan_.first_conv.bias), skip(0));
    const std::size_t n_levels = widths_.size() - 1;
    for (std::size_t l = 1; l <= n_levels; ++l) {
        const Slice pooled = levels_[l].pooled, between = levels_[l].down_between;
        resample_.max_pool(stream, skip(l - 1), pooled);
        run_conv_block(stream, plan_.down[2 * l - 2], down_states_[2 * l - 2], pooled, between, mode);
        run_conv_block(stream, plan_.down[2 * l - 1], down_states_[2 * l - 1], between,
                       l < n_levels ? skip(l) : levels_[l].up, mode);
    }
    if (attention_) run_attention(stream, mode);
    // The decoder goes from the smallest level to the full size. It joins the upsampled
    // images of the level below with the skip connection.
    for (std::size_t l = plan_.up.size() / 2; l-- > 0;) {
        const LevelBuffers& level = levels_[l];
        if (const std::uint32_t below = upsampled_channels(widths_, l); below > 0) {
            const bool smallest = l + 1 == n_levels;
            resample_.upsample(stream, smallest && attention_ ? mixed_ : levels_[l + 1].up,
                               level.joined.channel_range(0, below));
        }
        run_conv_block(stream, plan_.up[2 * l], up_states_[2 * l], level.joined, level.up_between, mode);
        run_conv_block(stream, plan_.up[2 * l + 1], up_states_[2 * l + 1], level.up_between, level.up, mode);
    }
    conv1_.run_convolution(stream, levels_[0].up, conv_weights(plan_.last_conv.weights),
                           conv_bias(*plan_.last_conv.bias), logit_);
}

void Unet::forward(Stream& stream, std::uint32_t dropout_key, float dropout_rate) {
    std::uint32_t key = dropout_key;
    for (std::vector<BlockState>* states : {&down_states_, &up_states_})
        for (BlockState& state : *states) {
            state.norm.dropout_key = key++;
            state.norm.dropout = dropout_rate;
        }
    run_all_layers(stream, Mode::train);
}

void Unet::run_inference(Stream& stream) { run_all_layers(stream, Mode::evaluate); }

void Unet::conv_vjp(Stream& stream, const ConvOffsets& layer, const Slice& input, const Slice& d_out) {
    conv_kernels(layer).weights_vjp(stream, input, d_out,
                                    gradients_.address_as<float, shared::ConvWeights>(layer.weights));
    if (layer.bias)
        norm_.bias_vjp(stream, d_out, gradients_.address_as<float, shared::ConvBias>(*layer.bias));
}

void Unet::block_vjp(Stream& s, const BlockOffsets& b, BlockState& a, const Slice& in, const Slice& d_out,
                     const Slice& d_in, bool add) {
    const Slice d_active{{scratch_.values.address(), b.conv.n_in, 0}, b.conv.n_in, in.grid};
    conv_vjp(s, b.conv, a.active, d_out);
    conv_kernels(b.conv).input_vjp(s, d_out, conv_weights(b.conv.weights), d_active);
    norm_.norm_vjp(s, in, a.norm, d_active, d_in, {gradients_, b.beta_gamma}, add);
}

void Unet::attention_vjp(Stream& stream) {
    const LevelBuffers& smallest = levels_.back();
    conv_vjp(stream, plan_.project, attended_, d_mixed_);
    conv1_.input_vjp(stream, d_mixed_, conv_weights(plan_.project.weights), d_attended_);
    attention_->attend_vjp(stream, qkv_, attention_state_, d_attended_, d_qkv_);
    stream.copy(d_mixed_.values.buffer(), smallest.d_up.values.buffer(),
                d_mixed_.values.size() * sizeof(float));
    block_vjp(stream, *plan_.query, query_state_, smallest.up, d_qkv_, smallest.d_up, true);
}

void Unet::backward(Stream& stream) {
    // Processes all layers of run_all_layers() in reverse order.
    const std::size_t n_levels = widths_.size() - 1;
    conv_vjp(stream, plan_.last_conv, levels_[0].up, d_logit_);
    conv1_.input_vjp(stream, d_logit_, conv_weights(plan_.last_conv.weights), levels_[0].d_up);
    for (std::size_t l = 0; l < plan_.up.size() / 2; ++l) {
        const LevelBuffers& level = levels_[l];
        const Slice between = level.up_between, d_between = level.d_up_between;
        block_vjp(stream, plan_.up[2 * l + 1], up_states_[2 * l + 1], between, level.d_up, d_between);
        block_vjp(stream, plan_.up[2 * l], up_states_[2 * l], level.joined, d_between, level.d_joined);
        if (const std::uint32_t below = upsampled_channels(widths_, l); below > 0) {
            const bool smallest = l + 1 == n_levels;
            resample_.upsample_vjp(stream, level.d_joined.channel_range(0, below),
                                   smallest && attention_ ? d_mixed_ : levels_[l + 1].d_up);
        }
    }
    if (attention_) attention_vjp(stream);
    // d_skip() already has the gradient from the decoder. max_pool_vjp() adds to it.
    for (std::size_t l = n_levels; l > 0; --l) {
        const LevelBuffers& level = levels_[l];
        const Slice d_to = l < n_levels ? d_skip(l) : level.d_up, between = level.down_between;
        block_vjp(stream, plan_.down[2 * l - 1], down_states_[2 * l - 1], between, d_to,
                  level.d_down_between);
        block_vjp(stream, plan_.down[2 * l - 2], down_states_[2 * l - 2], level.pooled, level.d_down_between,
                  level.d_pooled);
        resample_.max_pool_vjp(stream, skip(l - 1), level.d_pooled, d_skip(l - 1));
    }
    conv_vjp(stream, plan_.first_conv, inputs_, d_skip(0));
}

}  // namespace relidar::network
