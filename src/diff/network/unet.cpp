// SPDX-License-Identifier: Apache-2.0
// Forward and backward passes of the U-Net. The skip connections need no copy: an encoder
// block writes into some channels of the tensor that the decoder reads. In the backward
// pass, they keep their gradient until that from the smaller image size is added.
#include "diff/network/unet.hpp"

#include <algorithm>

namespace relidar::network {
namespace {

void copy_images(Stream& stream, const Tensor& from, const Tensor& to) {
    stream.copy(from.values.buffer(), to.values.buffer(), from.values.size() * sizeof(float));
}

}  // namespace

Unet::Unet(Device& device, const RayDropNetwork& network)
    : plan_(network),
      conv1_(device, 1),
      conv3_(device, 9),
      norm_(device),
      resample_(device),
      parameters_(device, network.parameters, "network parameters"),
      running_(device, network.running, "running moments") {
    if (network.heads > 0) attention_.emplace(device, network.heads);
}

Slice Unet::skip_part(const Tensor& joined, std::size_t level) const {
    return joined.channel_range(plan_.n_upsampled[level], joined.channels - plan_.n_upsampled[level]);
}

/// Returns the images that a decoder level enlarges. If there is attention, it processes
/// the output of the smallest level.
const Unet::Activation& Unet::level_below(std::size_t level) const {
    return attention_ && level + 1 == smallest_level() ? mixed_ : levels_[level + 1].output;
}

Unet::Activation Unet::make_images(Device& device, std::uint32_t channels, ImageBatchSize grid,
                                   const std::string& text) const {
    Activation images{.values = Tensor(device, channels, grid, text), .gradient = {}};
    if (with_gradients_) images.gradient = Tensor(device, channels, grid, "gradient of " + text);
    return images;
}

/// Reserves memory for the temporary sums of conv_vjp().
void Unet::reserve_vjp_sums(Device& device, const ConvOffsets& layer, ImageBatchSize grid) {
    if (!with_gradients_) return;
    conv_kernels(layer).reserve_weight_sums(device, grid, layer.n_in, layer.n_out);
    if (layer.bias) norm_.reserve_sums(layer.n_out, grid);
}

/// Allocates the results of a block that the backward pass needs, and temporary sums.
/// Adds the size of the results to the maximum `most_active_`.
void Unet::allocate_block(Device& device, const BlockOffsets& block, ImageBatchSize grid, BlockState& state) {
    state.active = Tensor(device, block.conv.n_in, grid, "activations");
    state.norm = NormState(device, block.conv.n_in);
    norm_.reserve_sums(block.conv.n_in, grid);
    reserve_vjp_sums(device, block.conv, grid);
    most_active_ = std::max(most_active_, block.conv.n_in * grid.n_pixels_total());
}

void Unet::allocate_pair(Device& device, const BlockPair& blocks, ImageBatchSize grid,
                         BlockPairState& state) {
    state.between = make_images(device, blocks[1].conv.n_in, grid, "activations");
    for (std::size_t k = 0; k < 2; ++k) allocate_block(device, blocks[k], grid, state.blocks[k]);
}

/// Allocates the input and output images of one level with the size `grid`. The output is
/// that of the decoder, if any. The smallest level has none, unless it is the only one.
void Unet::allocate_level(Device& device, std::size_t level, ImageBatchSize grid) {
    LevelImages& images = levels_[level];
    std::uint32_t n_output = 0;
    if (level > 0) {
        const BlockPair& blocks = plan_.down[level - 1];  // level 0 has no encoder
        allocate_pair(device, blocks, grid, encoders_[level - 1]);
        images.pooled = make_images(device, blocks[0].conv.n_in, grid, "activations");
        n_output = blocks[1].conv.n_out;
    }
    if (level < plan_.up.size()) {
        const BlockPair& blocks = plan_.up[level];
        allocate_pair(device, blocks, grid, decoders_[level]);
        images.joined = make_images(device, blocks[0].conv.n_in, grid, "activations");
        n_output = blocks[1].conv.n_out;
    }
    images.output = make_images(device, n_output, grid, "activations");
}

void Unet::allocate(Device& device, ImageBatchSize grid, bool with_gradients) {
    const bool is_allocated = inputs_.grid == grid && (with_gradients_ || !with_gradients);
    if (is_allocated) return;
    with_gradients_ = with_gradients;
    most_active_ = 0;  // becomes the largest number of activations of a block
    // Frees the old arrays before it allocates new arrays, because the memory may be too
    // small for both.
    levels_.clear();
    encoders_.clear();
    decoders_.clear();
    levels_.resize(smallest_level() + 1);
    encoders_.resize(plan_.down.size());
    decoders_.resize(plan_.up.size());
    inputs_ = Tensor(device, plan_.first_conv.n_in, grid, "network inputs");
    logit_ = make_images(device, 1, grid, "drop logits");
    if (with_gradients) gradients_.reserve(device, parameters_.size(), "gradients of the network");
    for (const ConvOffsets* layer : {&plan_.first_conv, &plan_.last_conv})
        reserve_vjp_sums(device, *layer, grid);
    ImageBatchSize level_grid = grid;
    for (std::size_t level = 0; level < levels_.size(); ++level) {
        allocate_level(device, level, level_grid);
        level_grid = half_size(level_grid);
    }
    if (attention_) allocate_attention(device);  // of the smallest level
    // The backward pass computes one block at a time, so all share the memory.
    if (with_gradients)
        scratch_ = Tensor(device, 1, {1, 1, std::uint32_t(most_active_)}, "gradient of activations");
}

/// Allocates the arrays of the attention, which works on the smallest images.
void Unet::allocate_attention(Device& device) {
    const ImageBatchSize& smallest = levels_.back().output.values.grid;
    allocate_block(device, *plan_.query, smallest, query_state_);
    qkv_ = make_images(device, plan_.query->conv.n_out, smallest, "queries, keys and values");
    attended_ = make_images(device, plan_.project.n_in, smallest, "attention");
    mixed_ = make_images(device, plan_.project.n_out, smallest, "attention added");
    attention_state_ = attention_->allocate_state(smallest, with_gradients_);
    reserve_vjp_sums(device, plan_.project, smallest);
}

/// Runs a block: normalisation, ReLU, dropout (only in training), convolution.
/// @param state receives the results that the backward pass needs
void Unet::run_block(Stream& stream, const BlockOffsets& block, BlockState& state, const Slice& in,
                     const Slice& out, Mode mode) {
    const NormWeights norm_weights{parameters_.address_as<glm::vec2, shared::BetaGamma>(block.beta_gamma),
                                   running_.address_as<glm::vec2, shared::RunningMoments>(block.running)};
    if (mode == Mode::train) norm_.normalise_batch(stream, in, norm_weights, state.norm, state.active);
    else norm_.normalise(stream, in, norm_weights, state.norm, state.active);
    conv_kernels(block.conv).run_convolution(stream, state.active, conv_weights(block.conv.weights), {}, out);
}

void Unet::run_pair(Stream& stream, const BlockPair& blocks, BlockPairState& state, const Slice& in,
                    const Slice& out, Mode mode) {
    run_block(stream, blocks[0], state.blocks[0], in, state.between.values, mode);
    run_block(stream, blocks[1], state.blocks[1], state.between.values, out, mode);
}

/// Writes the smallest images plus their self-attention to `mixed_`.
void Unet::run_attention(Stream& stream, Mode mode) {
    const Tensor& smallest = levels_.back().output.values;
    run_block(stream, *plan_.query, query_state_, smallest, qkv_.values, mode);
    attention_->attend(stream, qkv_.values, attention_state_, attended_.values);
    copy_images(stream, smallest, mixed_.values);
    const bool add = true;  // residual connection
    run_biased_conv(stream, plan_.project, attended_.values, mixed_.values, add);
}

/// Halves the images of the level above, and runs both encoder blocks. Writes the result
/// to the skip connection or, at the smallest level, to `output`.
void Unet::encode_level(Stream& stream, std::size_t level, Mode mode) {
    const LevelImages& images = levels_[level];
    const Slice output = level < smallest_level() ? skip(level) : images.output.values;
    resample_.max_pool(stream, skip(level - 1), images.pooled.values);
    run_pair(stream, plan_.down[level - 1], encoders_[level - 1], images.pooled.values, output, mode);
}

/// Joins the enlarged images of the level below with the skip connection, and runs both
/// decoder blocks. A network with one level has no level below.
void Unet::decode_level(Stream& stream, std::size_t level, Mode mode) {
    const LevelImages& images = levels_[level];
    if (const std::uint32_t n_upsampled = plan_.n_upsampled[level]; n_upsampled > 0)
        resample_.upsample(stream, level_below(level).values,
                           images.joined.values.channel_range(0, n_upsampled));
    run_pair(stream, plan_.up[level], decoders_[level], images.joined.values, images.output.values, mode);
}

/// Computes the logits of the input images: encoder from the full image size to the
/// smallest, attention, and decoder back to the full size.
void Unet::run_all_layers(Stream& stream, Mode mode) {
    run_biased_conv(stream, plan_.first_conv, inputs_, skip(0));
    for (std::size_t level = 1; level <= smallest_level(); ++level) encode_level(stream, level, mode);
    if (attention_) run_attention(stream, mode);
    for (std::size_t level = plan_.up.size(); level-- > 0;) decode_level(stream, level, mode);
    run_biased_conv(stream, plan_.last_conv, levels_[0].output.values, logit_.values);
}

void Unet::forward(Stream& stream, std::uint32_t dropout_key, float dropout_rate) {
    std::uint32_t key = dropout_key;  // each block drops other values
    for (std::vector<BlockPairState>* pairs : {&encoders_, &decoders_})
        for (BlockPairState& pair : *pairs)
            for (BlockState& state : pair.blocks) {
                state.norm.dropout_key = key++;
                state.norm.dropout = dropout_rate;
            }
    run_all_layers(stream, Mode::train);
}

void Unet::run_inference(Stream& stream) { run_all_layers(stream, Mode::evaluate); }

/// Computes the gradients of a convolution: of its weights, its bias, and its input.
/// @param d_in receives the gradient of the input, if it is needed
void Unet::conv_vjp(Stream& stream, const ConvOffsets& layer, const Slice& in, const Slice& d_out,
                    const std::optional<Slice>& d_in) {
    Convolution& conv = conv_kernels(layer);
    conv.weights_vjp(stream, in, d_out, gradients_.address_as<float, shared::ConvWeights>(layer.weights));
    if (layer.bias)
        norm_.bias_vjp(stream, d_out, gradients_.address_as<float, shared::ConvBias>(*layer.bias));
    if (d_in) conv.input_vjp(stream, d_out, conv_weights(layer.weights), *d_in);
}

/// Backward pass of run_block(): gradients of the parameters and of the input.
/// @param add true: adds the gradient of the input to `d_in` instead of overwriting it
void Unet::block_vjp(Stream& stream, const BlockOffsets& block, BlockState& state, const Slice& in,
                     const Slice& d_out, const Slice& d_in, bool add) {
    const std::uint32_t channels = block.conv.n_in;
    const Slice d_active{{scratch_.values.address(), channels, 0}, channels, in.grid};
    conv_vjp(stream, block.conv, state.active, d_out, d_active);
    norm_.norm_vjp(stream, in, state.norm, d_active, d_in, {gradients_, block.beta_gamma}, add);
}

void Unet::pair_vjp(Stream& stream, const BlockPair& blocks, BlockPairState& state, const Slice& in,
                    const Slice& d_out, const Slice& d_in) {
    const Activation& between = state.between;
    block_vjp(stream, blocks[1], state.blocks[1], between.values, d_out, between.gradient);
    block_vjp(stream, blocks[0], state.blocks[0], in, between.gradient, d_in);
}

/// Backward pass of run_attention(). `mixed_` is a sum, so its gradient is the gradient
/// of the smallest images, to which the gradient through the attention is added.
void Unet::attention_vjp(Stream& stream) {
    const Activation& smallest = levels_.back().output;
    conv_vjp(stream, plan_.project, attended_.values, mixed_.gradient, attended_.gradient);
    attention_->attend_vjp(stream, qkv_.values, attention_state_, attended_.gradient, qkv_.gradient);
    copy_images(stream, mixed_.gradient, smallest.gradient);
    const bool add = true;
    block_vjp(stream, *plan_.query, query_state_, smallest.values, qkv_.gradient, smallest.gradient, add);
}

/// Backward pass of decode_level(). The gradient of `joined` contains the gradient of the
/// skip connection, which encode_vjp() of the same level uses.
void Unet::decode_vjp(Stream& stream, std::size_t level) {
    const LevelImages& images = levels_[level];
    pair_vjp(stream, plan_.up[level], decoders_[level], images.joined.values, images.output.gradient,
             images.joined.gradient);
    if (const std::uint32_t n_upsampled = plan_.n_upsampled[level]; n_upsampled > 0)
        resample_.upsample_vjp(stream, images.joined.gradient.channel_range(0, n_upsampled),
                               level_below(level).gradient);
}

/// Backward pass of encode_level(). Adds to the gradient that the skip connection of the
/// level above got from the decoder.
void Unet::encode_vjp(Stream& stream, std::size_t level) {
    const Activation& pooled = levels_[level].pooled;
    const Slice d_output = level < smallest_level() ? d_skip(level) : levels_[level].output.gradient;
    pair_vjp(stream, plan_.down[level - 1], encoders_[level - 1], pooled.values, d_output, pooled.gradient);
    resample_.max_pool_vjp(stream, skip(level - 1), pooled.gradient, d_skip(level - 1));
}

/// Computes the gradients of all layers of run_all_layers() in reverse order.
void Unet::backward(Stream& stream) {
    const Activation& decoded = levels_[0].output;
    conv_vjp(stream, plan_.last_conv, decoded.values, logit_.gradient, decoded.gradient);
    for (std::size_t level = 0; level < plan_.up.size(); ++level) decode_vjp(stream, level);
    if (attention_) attention_vjp(stream);
    for (std::size_t level = smallest_level(); level > 0; --level) encode_vjp(stream, level);
    conv_vjp(stream, plan_.first_conv, inputs_, d_skip(0), std::nullopt);
}

}  // namespace relidar::network
