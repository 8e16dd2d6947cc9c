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

ChannelSlice Unet::get_skip_connection(std::size_t level) const {
    return levels_[level].joined.get_channel_range(count_upsampled_channels(widths_, level), widths_[level]);
}
ChannelSlice Unet::get_skip_connection_gradient(std::size_t level) const {
    return levels_[level].d_joined.get_channel_range(count_upsampled_channels(widths_, level),
                                                     widths_[level]);
}

void Unet::allocate_block_activations(Device& device, const UnetBlockOffsets& block,
                                      const ImageBatchSize& grid, UnetBlockActivations& state) {
    state.active = Tensor(device, block.conv.n_in, grid, "activations");
    state.norm = NormActivations(device, block.conv.n_in);
    norm_.reserve_channel_sums(device, block.conv.n_in, grid);
    if (!with_gradients_) return;
    most_active_ = std::max(most_active_, block.conv.n_in * grid.count_all_pixels());
    ConvolutionKernels& conv = get_convolution_kernels(block.conv);
    conv.reserve_partial_sums(device, conv.count_partial_sum_floats(grid, block.conv.n_in, block.conv.n_out));
}

void Unet::allocate_level_tensors(Device& device, std::size_t level, const ImageBatchSize& grid) {
    UnetLevelBuffers& l = levels_[level];
    const auto tensors = [&](Tensor& values, Tensor& gradients, std::uint32_t channels,
                             const ImageBatchSize& of) {
        values = Tensor(device, channels, of, "activations");
        if (with_gradients_) gradients = Tensor(device, channels, of, "gradients of activations");
    };
    if (level > 0) {
        tensors(l.pooled, l.d_pooled, widths_[level - 1], grid);
        tensors(l.down_between, l.d_down_between, widths_[level], grid);
        for (std::size_t k = 0; k < 2; ++k)
            allocate_block_activations(device, plan_.down[2 * level - 2 + k], grid,
                                       down_states_[2 * level - 2 + k]);
    }
    if (2 * level >= plan_.up.size()) {  // smallest image size
        tensors(l.up, l.d_up, widths_[level], grid);
        return;
    }
    tensors(l.joined, l.d_joined, count_concatenated_channels(widths_, level), grid);
    tensors(l.up_between, l.d_up_between, count_concatenated_channels(widths_, level), grid);
    tensors(l.up, l.d_up, count_decoder_channels(widths_, level), grid);
    for (std::size_t k = 0; k < 2; ++k)
        allocate_block_activations(device, plan_.up[2 * level + k], grid, up_states_[2 * level + k]);
}

void Unet::allocate_activations(Device& device, const ImageBatchSize& grid, bool with_gradients) {
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
    for (std::size_t level = 0; level < levels_.size(); ++level, at = halve_image_size(at))
        allocate_level_tensors(device, level, at);
    for (const ConvParameterOffsets* layer : {&plan_.first_conv, &plan_.last_conv})
        conv1_.reserve_partial_sums(device, conv1_.count_partial_sum_floats(grid, layer->n_in, layer->n_out));
    norm_.reserve_channel_sums(device, 1, grid);
    norm_.reserve_channel_sums(device, widths_[0], grid);
    if (attention_) allocate_attention_tensors(device);
    if (with_gradients)
        scratch_ = Tensor(device, 1, {1, 1, std::uint32_t(most_active_)}, "gradient of activations");
}

void Unet::allocate_attention_tensors(Device& device) {
    const ImageBatchSize& smallest = levels_.back().up.grid;
    const std::uint32_t channels = widths_.back();
    allocate_block_activations(device, *plan_.query, smallest, query_state_);
    qkv_ = Tensor(device, 3 * channels, smallest, "queries, keys and values");
    attended_ = Tensor(device, channels, smallest, "attention");
    mixed_ = Tensor(device, channels, smallest, "attention added");
    attention_state_ = attention_->allocate_attention_activations(device, smallest, with_gradients_);
    conv1_.reserve_partial_sums(device, conv1_.count_partial_sum_floats(smallest, channels, channels));
    if (!with_gradients_) return;
    d_qkv_ = Tensor(device, 3 * channels, smallest, "gradient of queries");
    d_attended_ = Tensor(device, channels, smallest, "gradient of attention");
    d_mixed_ = Tensor(device, channels, smallest, "gradient of attention added");
}

void Unet::run_conv_block(Stream& stream, const UnetBlockOffsets& block, UnetBlockActivations& state,
                          const ChannelSlice& input, const ChannelSlice& output, UnetMode mode) {
    const NormWeights norm_weights{parameters_.address_as<glm::vec2, shared::BetaGamma>(block.beta_gamma),
                                   running_.address_as<glm::vec2, shared::RunningMoments>(block.running)};
    if (mode == UnetMode::train)
        norm_.run_norm_relu_dropout_for_training(stream, input, norm_weights, state.norm, state.active);
    else norm_.run_norm_relu_for_inference(stream, input, norm_weights, state.norm, state.active);
    get_convolution_kernels(block.conv)
        .run_convolution(stream, state.active, get_conv_weights(block.conv.weights), {}, output);
}

void Unet::run_attention_layer(Stream& stream, UnetMode mode) {
    const Tensor& bottom = levels_.back().up;
    run_conv_block(stream, *plan_.query, query_state_, bottom, qkv_, mode);
    attention_->compute_attention(stream, qkv_, attention_state_, attended_);
    stream.copy(bottom.values.buffer(), mixed_.values.buffer(), bottom.values.size() * sizeof(float));
    conv1_.run_convolution(stream, attended_, get_conv_weights(plan_.project.weights),
                           get_conv_bias(*plan_.project.bias), mixed_, true);
}

void Unet::run_all_layers(Stream& stream, UnetMode mode) {
    conv1_.run_convolution(stream, inputs_, get_conv_weights(plan_.first_conv.weights),
                           get_conv_bias(*plan_.first_conv.bias), get_skip_connection(0));
    const std::size_t n_levels = widths_.size() - 1;
    for (std::size_t l = 1; l <= n_levels; ++l) {
        const ChannelSlice pooled = levels_[l].pooled, between = levels_[l].down_between;
        resample_.max_pool(stream, get_skip_connection(l - 1), pooled);
        run_conv_block(stream, plan_.down[2 * l - 2], down_states_[2 * l - 2], pooled, between, mode);
        run_conv_block(stream, plan_.down[2 * l - 1], down_states_[2 * l - 1], between,
                       l < n_levels ? get_skip_connection(l) : levels_[l].up, mode);
    }
    if (attention_) run_attention_layer(stream, mode);
    for (std::size_t l = plan_.up.size() / 2; l-- > 0;) {
        const UnetLevelBuffers& level = levels_[l];
        if (const std::uint32_t below = count_upsampled_channels(widths_, l); below > 0) {
            const bool smallest = l + 1 == n_levels;
            resample_.upsample_bilinear(stream, smallest && attention_ ? mixed_ : levels_[l + 1].up,
                                        level.joined.get_channel_range(0, below));
        }
        run_conv_block(stream, plan_.up[2 * l], up_states_[2 * l], level.joined, level.up_between, mode);
        run_conv_block(stream, plan_.up[2 * l + 1], up_states_[2 * l + 1], level.up_between, level.up, mode);
    }
    conv1_.run_convolution(stream, levels_[0].up, get_conv_weights(plan_.last_conv.weights),
                           get_conv_bias(*plan_.last_conv.bias), logit_);
}

void Unet::run_training_forward_pass(Stream& stream, std::uint32_t dropout_key, float dropout_rate) {
    std::uint32_t key = dropout_key;
    for (std::vector<UnetBlockActivations>* states : {&down_states_, &up_states_})
        for (UnetBlockActivations& state : *states) {
            state.norm.dropout_key = key++;
            state.norm.dropout = dropout_rate;
        }
    run_all_layers(stream, UnetMode::train);
}

void Unet::run_inference(Stream& stream) { run_all_layers(stream, UnetMode::evaluate); }

void Unet::backpropagate_conv_parameters(Stream& stream, const ConvParameterOffsets& layer,
                                         const ChannelSlice& input, const ChannelSlice& d_output) {
    get_convolution_kernels(layer).backpropagate_weights(
        stream, input, d_output, gradients_.address_as<float, shared::ConvWeights>(layer.weights));
    if (layer.bias)
        norm_.backpropagate_bias(stream, d_output,
                                 gradients_.address_as<float, shared::ConvBias>(*layer.bias));
}

void Unet::backpropagate_conv_block(Stream& stream, const UnetBlockOffsets& block,
                                    UnetBlockActivations& state, const ChannelSlice& input,
                                    const ChannelSlice& d_output, const ChannelSlice& d_input,
                                    bool accumulate) {
    const ChannelSlice d_active{{scratch_.values.address(), block.conv.n_in, 0}, block.conv.n_in, input.grid};
    backpropagate_conv_parameters(stream, block.conv, state.active, d_output);
    get_convolution_kernels(block.conv)
        .backpropagate_input(stream, d_output, get_conv_weights(block.conv.weights), d_active);
    norm_.backpropagate_norm_layer(stream, input, state.norm, d_active, d_input,
                                   {gradients_, block.beta_gamma}, accumulate);
}

void Unet::backpropagate_attention(Stream& stream) {
    const UnetLevelBuffers& smallest = levels_.back();
    backpropagate_conv_parameters(stream, plan_.project, attended_, d_mixed_);
    conv1_.backpropagate_input(stream, d_mixed_, get_conv_weights(plan_.project.weights), d_attended_);
    attention_->backpropagate_to_qkv(stream, qkv_, attention_state_, d_attended_, d_qkv_);
    stream.copy(d_mixed_.values.buffer(), smallest.d_up.values.buffer(),
                d_mixed_.values.size() * sizeof(float));
    backpropagate_conv_block(stream, *plan_.query, query_state_, smallest.up, d_qkv_, smallest.d_up, true);
}

void Unet::run_backward_pass(Stream& stream) {
    const std::size_t n_levels = widths_.size() - 1;
    backpropagate_conv_parameters(stream, plan_.last_conv, levels_[0].up, d_logit_);
    conv1_.backpropagate_input(stream, d_logit_, get_conv_weights(plan_.last_conv.weights), levels_[0].d_up);
    for (std::size_t l = 0; l < plan_.up.size() / 2; ++l) {
        const UnetLevelBuffers& level = levels_[l];
        const ChannelSlice between = level.up_between, d_between = level.d_up_between;
        backpropagate_conv_block(stream, plan_.up[2 * l + 1], up_states_[2 * l + 1], between, level.d_up,
                                 d_between);
        backpropagate_conv_block(stream, plan_.up[2 * l], up_states_[2 * l], level.joined, d_between,
                                 level.d_joined);
        if (const std::uint32_t below = count_upsampled_channels(widths_, l); below > 0) {
            const bool smallest = l + 1 == n_levels;
            resample_.backpropagate_upsample(stream, level.d_joined.get_channel_range(0, below),
                                             smallest && attention_ ? d_mixed_ : levels_[l + 1].d_up);
        }
    }
    if (attention_) backpropagate_attention(stream);
    for (std::size_t l = n_levels; l > 0; --l) {
        const UnetLevelBuffers& level = levels_[l];
        const ChannelSlice d_to = l < n_levels ? get_skip_connection_gradient(l) : level.d_up,
                           between = level.down_between;
        backpropagate_conv_block(stream, plan_.down[2 * l - 1], down_states_[2 * l - 1], between, d_to,
                                 level.d_down_between);
        backpropagate_conv_block(stream, plan_.down[2 * l - 2], down_states_[2 * l - 2], level.pooled,
                                 level.d_down_between, level.d_pooled);
        resample_.backpropagate_max_pool(stream, get_skip_connection(l - 1), level.d_pooled,
                                         get_skip_connection_gradient(l - 1));
    }
    backpropagate_conv_parameters(stream, plan_.first_conv, inputs_, get_skip_connection_gradient(0));
}

}  // namespace relidar::network
