// SPDX-License-Identifier: Apache-2.0
// Forward and backward passes of the U-Net. Each encoder block writes directly into the
// channels of the tensor that the decoder reads, so that the skip connection needs no
// copy. In the backward pass, these channels keep their gradient until the gradient from
// the smaller image size is added.
#include "diff/network/unet.hpp"

#include <algorithm>

namespace relidar::refine {

Unet::Unet(Device& device, const DropNetwork& network)
    : plan_(network),
      widths_(network.widths),
      conv1_(device, 1),
      conv3_(device, 9),
      norm_(device),
      resample_(device),
      parameters_(device, std::span<const float>(network.parameters), "network parameters"),
      running_(device, std::span<const float>(network.running), "running moments") {
    if (network.heads > 0) attention_.emplace(device, network.heads);
}

Slice Unet::skip(std::size_t level) const {
    return levels_[level].joined.all().part(count_channels_below(widths_, level), widths_[level]);
}
Slice Unet::d_skip(std::size_t level) const {
    return levels_[level].d_joined.all().part(count_channels_below(widths_, level), widths_[level]);
}

void Unet::reserve_block(Device& device, const Block& block, const Grid& grid, BlockState& state) {
    state.active = Tensor(device, block.conv.n_in, grid, "activations");
    state.norm = NormState(device, block.conv.n_in);
    norm_.reserve(device, block.conv.n_in, grid);
    if (!with_gradients_) return;
    most_active_ = std::max(most_active_, block.conv.n_in * grid.all_pixels());
    Conv& conv = get_conv(block.conv);
    conv.reserve(device, conv.count_partial_floats(grid, block.conv.n_in, block.conv.n_out));
}

void Unet::reserve_level(Device& device, std::size_t level, const Grid& grid) {
    Level& l = levels_[level];
    const auto tensors = [&](Tensor& values, Tensor& gradients, std::uint32_t channels, const Grid& of) {
        values = Tensor(device, channels, of, "activations");
        if (with_gradients_) gradients = Tensor(device, channels, of, "gradients of activations");
    };
    if (level > 0) {
        tensors(l.pooled, l.d_pooled, widths_[level - 1], grid);
        tensors(l.down_between, l.d_down_between, widths_[level], grid);
        for (std::size_t k = 0; k < 2; ++k)
            reserve_block(device, plan_.down[2 * level - 2 + k], grid, down_states_[2 * level - 2 + k]);
    }
    if (2 * level >= plan_.up.size()) {  // smallest image size
        tensors(l.up, l.d_up, widths_[level], grid);
        return;
    }
    tensors(l.joined, l.d_joined, count_concatenated_channels(widths_, level), grid);
    tensors(l.up_between, l.d_up_between, count_concatenated_channels(widths_, level), grid);
    tensors(l.up, l.d_up, count_decoder_channels(widths_, level), grid);
    for (std::size_t k = 0; k < 2; ++k)
        reserve_block(device, plan_.up[2 * level + k], grid, up_states_[2 * level + k]);
}

void Unet::reserve(Device& device, const Grid& grid, bool with_gradients) {
    if (inputs_.grid == grid && (with_gradients_ || !with_gradients)) return;
    with_gradients_ = with_gradients;
    most_active_ = 0;
    // Frees the old arrays before it allocates new arrays, because both may not fit into
    // the memory.
    levels_.clear();
    levels_.resize(widths_.size());
    down_states_.resize(plan_.down.size());
    up_states_.resize(plan_.up.size());
    inputs_ = Tensor(device, plan_.head.n_in, grid, "network inputs");
    logit_ = Tensor(device, 1, grid, "drop logits");
    if (with_gradients) d_logit_ = Tensor(device, 1, grid, "gradient of drop logits");
    if (with_gradients) gradients_.reserve(device, parameters_.size(), "gradients of the network");
    Grid at = grid;
    for (std::size_t level = 0; level < levels_.size(); ++level, at = halve_grid(at))
        reserve_level(device, level, at);
    for (const ConvLayer* layer : {&plan_.head, &plan_.tail})
        conv1_.reserve(device, conv1_.count_partial_floats(grid, layer->n_in, layer->n_out));
    norm_.reserve(device, 1, grid);
    norm_.reserve(device, widths_[0], grid);
    if (attention_) reserve_attention(device);
    if (with_gradients)
        scratch_ = Tensor(device, 1, {1, 1, std::uint32_t(most_active_)}, "gradient of activations");
}

void Unet::reserve_attention(Device& device) {
    const Grid& smallest = levels_.back().up.grid;
    const std::uint32_t channels = widths_.back();
    reserve_block(device, *plan_.query, smallest, query_state_);
    qkv_ = Tensor(device, 3 * channels, smallest, "queries, keys and values");
    attended_ = Tensor(device, channels, smallest, "attention");
    mixed_ = Tensor(device, channels, smallest, "attention added");
    attention_state_ = attention_->make_state(device, smallest, with_gradients_);
    conv1_.reserve(device, conv1_.count_partial_floats(smallest, channels, channels));
    if (!with_gradients_) return;
    d_qkv_ = Tensor(device, 3 * channels, smallest, "gradient of queries");
    d_attended_ = Tensor(device, channels, smallest, "gradient of attention");
    d_mixed_ = Tensor(device, channels, smallest, "gradient of attention added");
}

void Unet::run_block(Stream& stream, const Block& block, BlockState& state, const Slice& input,
                     const Slice& output, Mode mode) {
    const NormWeights norm_weights{parameters_.address_as<glm::vec2, shared::BetaGamma>(block.beta_gamma),
                                   running_.address_as<glm::vec2, shared::RunningMoments>(block.running)};
    if (mode == Mode::train) norm_.forward(stream, input, norm_weights, state.norm, state.active.all());
    else norm_.evaluate(stream, input, norm_weights, state.norm, state.active.all());
    get_conv(block.conv).forward(stream, state.active.all(), weights(block.conv.weights), {}, output);
}

void Unet::attend(Stream& stream, Mode mode) {
    const Tensor& bottom = levels_.back().up;
    run_block(stream, *plan_.query, query_state_, bottom.all(), qkv_.all(), mode);
    attention_->forward(stream, qkv_.all(), attention_state_, attended_.all());
    stream.copy(bottom.values.buffer(), mixed_.values.buffer(), bottom.values.size() * sizeof(float));
    conv1_.forward(stream, attended_.all(), weights(plan_.project.weights), bias(*plan_.project.bias),
                   mixed_.all(), true);
}

void Unet::run(Stream& stream, Mode mode) {
    conv1_.forward(stream, inputs_.all(), weights(plan_.head.weights), bias(*plan_.head.bias), skip(0));
    const std::size_t n_levels = widths_.size() - 1;
    for (std::size_t l = 1; l <= n_levels; ++l) {
        const Slice pooled = levels_[l].pooled.all(), between = levels_[l].down_between.all();
        resample_.pool(stream, skip(l - 1), pooled);
        run_block(stream, plan_.down[2 * l - 2], down_states_[2 * l - 2], pooled, between, mode);
        run_block(stream, plan_.down[2 * l - 1], down_states_[2 * l - 1], between,
                  l < n_levels ? skip(l) : levels_[l].up.all(), mode);
    }
    if (attention_) attend(stream, mode);
    for (std::size_t l = plan_.up.size() / 2; l-- > 0;) {
        const Level& level = levels_[l];
        if (const std::uint32_t below = count_channels_below(widths_, l); below > 0) {
            const bool smallest = l + 1 == n_levels;
            resample_.upsample(stream, smallest && attention_ ? mixed_.all() : levels_[l + 1].up.all(),
                               level.joined.all().part(0, below));
        }
        run_block(stream, plan_.up[2 * l], up_states_[2 * l], level.joined.all(), level.up_between.all(),
                  mode);
        run_block(stream, plan_.up[2 * l + 1], up_states_[2 * l + 1], level.up_between.all(), level.up.all(),
                  mode);
    }
    conv1_.forward(stream, levels_[0].up.all(), weights(plan_.tail.weights), bias(*plan_.tail.bias),
                   logit_.all());
}

void Unet::forward(Stream& stream, std::uint32_t dropout_key, float dropout) {
    std::uint32_t key = dropout_key;
    for (std::vector<BlockState>* states : {&down_states_, &up_states_})
        for (BlockState& state : *states) {
            state.norm.dropout_key = key++;
            state.norm.dropout = dropout;
        }
    run(stream, Mode::train);
}

void Unet::evaluate(Stream& stream) { run(stream, Mode::evaluate); }

void Unet::backpropagate_conv(Stream& stream, const ConvLayer& layer, const Slice& input, const Slice& d_to) {
    get_conv(layer).backpropagate_weights(stream, input, d_to,
                                          gradients_.address_as<float, shared::ConvWeights>(layer.weights));
    if (layer.bias)
        norm_.backpropagate_bias(stream, d_to, gradients_.address_as<float, shared::ConvBias>(*layer.bias));
}

void Unet::backpropagate_block(Stream& stream, const Block& block, BlockState& state, const Slice& input,
                               const Slice& d_to, const Slice& d_from, bool accumulate) {
    const Slice d_active{{scratch_.values.address(), block.conv.n_in, 0}, block.conv.n_in, input.grid};
    backpropagate_conv(stream, block.conv, state.active.all(), d_to);
    get_conv(block.conv).backpropagate_input(stream, d_to, weights(block.conv.weights), d_active);
    norm_.vjp(stream, input, state.norm, d_active, d_from, {gradients_, block.beta_gamma}, accumulate);
}

void Unet::backpropagate_attention(Stream& stream) {
    const Level& smallest = levels_.back();
    backpropagate_conv(stream, plan_.project, attended_.all(), d_mixed_.all());
    conv1_.backpropagate_input(stream, d_mixed_.all(), weights(plan_.project.weights), d_attended_.all());
    attention_->vjp(stream, qkv_.all(), attention_state_, d_attended_.all(), d_qkv_.all());
    stream.copy(d_mixed_.values.buffer(), smallest.d_up.values.buffer(),
                d_mixed_.values.size() * sizeof(float));
    backpropagate_block(stream, *plan_.query, query_state_, smallest.up.all(), d_qkv_.all(),
                        smallest.d_up.all(), true);
}

void Unet::backward(Stream& stream) {
    const std::size_t n_levels = widths_.size() - 1;
    backpropagate_conv(stream, plan_.tail, levels_[0].up.all(), d_logit_.all());
    conv1_.backpropagate_input(stream, d_logit_.all(), weights(plan_.tail.weights), levels_[0].d_up.all());
    for (std::size_t l = 0; l < plan_.up.size() / 2; ++l) {
        const Level& level = levels_[l];
        const Slice between = level.up_between.all(), d_between = level.d_up_between.all();
        backpropagate_block(stream, plan_.up[2 * l + 1], up_states_[2 * l + 1], between, level.d_up.all(),
                            d_between);
        backpropagate_block(stream, plan_.up[2 * l], up_states_[2 * l], level.joined.all(), d_between,
                            level.d_joined.all());
        if (const std::uint32_t below = count_channels_below(widths_, l); below > 0) {
            const bool smallest = l + 1 == n_levels;
            resample_.backpropagate_upsample(
                stream, level.d_joined.all().part(0, below),
                smallest && attention_ ? d_mixed_.all() : levels_[l + 1].d_up.all());
        }
    }
    if (attention_) backpropagate_attention(stream);
    for (std::size_t l = n_levels; l > 0; --l) {
        const Level& level = levels_[l];
        const Slice d_to = l < n_levels ? d_skip(l) : level.d_up.all(), between = level.down_between.all();
        backpropagate_block(stream, plan_.down[2 * l - 1], down_states_[2 * l - 1], between, d_to,
                            level.d_down_between.all());
        backpropagate_block(stream, plan_.down[2 * l - 2], down_states_[2 * l - 2], level.pooled.all(),
                            level.d_down_between.all(), level.d_pooled.all());
        resample_.backpropagate_pool(stream, skip(l - 1), level.d_pooled.all(), d_skip(l - 1));
    }
    backpropagate_conv(stream, plan_.head, inputs_.all(), d_skip(0));
}

}  // namespace relidar::refine
