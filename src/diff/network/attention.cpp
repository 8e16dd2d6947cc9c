// SPDX-License-Identifier: Apache-2.0
#include "diff/network/layers.hpp"

#include <cmath>

#include "base/assert.hpp"

namespace relidar::network {
namespace {

/// Describes an image slice as one matrix per attention head. Its shape is [channels,
/// pixels], or [pixels, channels] if `transposed` is true.
shared::MatrixView head_matrices(const Slice& slice, std::uint32_t n_heads, bool transposed) {
    const auto pixels = std::uint32_t(slice.grid.n_image_pixels());
    return {.values = slice.view.values,
            .first = slice.view.first * pixels,
            .batch = slice.view.channels * pixels,
            .head = slice.channels / n_heads * pixels,
            .row = transposed ? 1 : pixels,
            .column = transposed ? pixels : 1,
            .unused = 0};
}

/// Describes the attention weights as one matrix [pixels, pixels] per image and head,
/// transposed if `turned` is true.
shared::MatrixView attention_matrices(const Tensor& w, ImageBatchSize g, std::uint32_t heads, bool turned) {
    const auto pixels = std::uint32_t(g.n_image_pixels());
    return {.values = w.values.address(),
            .first = 0,
            .batch = heads * pixels * pixels,
            .head = pixels * pixels,
            .row = turned ? 1 : pixels,
            .column = turned ? pixels : 1,
            .unused = 0};
}

}  // namespace

Attention::Attention(Device& device, std::uint32_t heads)
    : device_(device),
      heads_(heads),
      matmul_(device, "diff/network/matmul", constants_, SubgroupRequirement::full),
      softmax_(device, "diff/network/softmax", constants_, SubgroupRequirement::full) {}

AttentionState Attention::allocate_state(ImageBatchSize grid, bool with_gradients) const {
    const auto channels = std::uint32_t(heads_ * grid.n_image_pixels());
    AttentionState state{Tensor(device_, channels, grid, "attention"), {}};
    if (with_gradients) state.d_share = Tensor(device_, channels, grid, "gradient of attention");
    return state;
}

/// Computes c = scale a b. `rows` and `inner` are the shape of `a`; b and c have a column
/// per pixel.
void Attention::multiply(Stream& stream, const shared::MatrixView& a, const shared::MatrixView& b,
                         const shared::MatrixView& c, std::uint32_t rows, std::uint32_t inner, float scale,
                         ImageBatchSize grid) const {
    const auto columns = std::uint32_t(grid.n_image_pixels());
    const std::uint32_t jobs =
        grid.n * heads_ * div_ceil(columns, lanes_) * div_ceil(rows, RELIDAR_MATMUL_ROWS);
    run(stream, matmul_, std::size_t(div_ceil(jobs, kThreads / lanes_)) * kThreads,
        {.a = a,
         .b = b,
         .c = c,
         .n_batch = grid.n,
         .n_heads = heads_,
         .rows = rows,
         .inner = inner,
         .columns = columns,
         .scale = scale});
}

void Attention::run_softmax(Stream& stream, AttentionState& attention, ImageBatchSize grid, bool vjp) const {
    const auto pixels = std::uint32_t(grid.n_image_pixels()), rows = grid.n * heads_ * pixels;
    run(stream, softmax_, std::size_t(div_ceil(rows, kThreads / lanes_)) * kThreads,
        {.values = attention.share.values.address().cast_tag<shared::SoftmaxValues>(),
         .d_values = (vjp ? attention.d_share.values.address() : Address<float>())
                         .cast_tag<shared::SoftmaxGradients>(),
         .n_rows = rows,
         .n = pixels});
}

void Attention::attend(Stream& stream, const Slice& qkv, AttentionState& state, const Slice& output) {
    const std::uint32_t channels = output.channels, size = channels / heads_,
                        pixels = std::uint32_t(output.grid.n_image_pixels());
    RELIDAR_ASSERT_EQ(qkv.channels, 3 * channels);
    const Slice query = qkv.channel_range(0, channels), key = qkv.channel_range(channels, channels),
                value = qkv.channel_range(2 * channels, channels);
    const ImageBatchSize& grid = output.grid;
    // Scores of all pairs of pixels: one row per query, one column per key.
    multiply(stream, head_matrices(query, heads_, true), head_matrices(key, heads_, false),
             attention_matrices(state.share, grid, heads_, false), pixels, size,
             1.0f / std::sqrt(float(size)), grid);
    // false: not the derivative.
    run_softmax(stream, state, grid, false);
    // Adds the values, weighted by each row of weights.
    multiply(stream, head_matrices(value, heads_, false), attention_matrices(state.share, grid, heads_, true),
             head_matrices(output, heads_, false), size, pixels, 1.0f, grid);
}

void Attention::attend_vjp(Stream& s, const Slice& qkv, AttentionState& a, const Slice& d_out,
                           const Slice& d_qkv) {
    const std::uint32_t channels = d_out.channels, size = channels / heads_,
                        pixels = std::uint32_t(d_out.grid.n_image_pixels());
    const Slice query = qkv.channel_range(0, channels), key = qkv.channel_range(channels, channels),
                value = qkv.channel_range(2 * channels, channels);
    const Slice d_query = d_qkv.channel_range(0, channels), d_key = d_qkv.channel_range(channels, channels),
                d_value = d_qkv.channel_range(2 * channels, channels);
    const ImageBatchSize& grid = d_out.grid;
    const float scale = 1.0f / std::sqrt(float(size));
    const auto product = [&](const shared::MatrixView& first, const shared::MatrixView& second,
                             const shared::MatrixView& c, std::uint32_t rows, std::uint32_t inner,
                             float factor) { multiply(s, first, second, c, rows, inner, factor, grid); };
    // computes d_value = d_out share
    product(head_matrices(d_out, heads_, false), attention_matrices(a.share, grid, heads_, false),
            head_matrices(d_value, heads_, false), size, pixels, 1.0f);
    // Computes d_share, the gradient of the attention weights: transposed d_out times
    // value. Then run_softmax() replaces it by the gradient of the softmax input.
    product(head_matrices(d_out, heads_, true), head_matrices(value, heads_, false),
            attention_matrices(a.d_share, grid, heads_, false), pixels, size, 1.0f);
    run_softmax(s, a, grid, true);
    product(head_matrices(key, heads_, false), attention_matrices(a.d_share, grid, heads_, true),
            head_matrices(d_query, heads_, false), size, pixels, scale);
    product(head_matrices(query, heads_, false), attention_matrices(a.d_share, grid, heads_, false),
            head_matrices(d_key, heads_, false), size, pixels, scale);
}

}  // namespace relidar::network
