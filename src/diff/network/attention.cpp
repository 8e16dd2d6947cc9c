// SPDX-License-Identifier: Apache-2.0
// Host side of multi-head attention: submits matrix products and the softmax. Attention
// weights are stored as [n, heads, query pixel, key pixel].
#include "diff/network/attention.hpp"

#include <cmath>

#include "base/assert.hpp"

namespace relidar::refine {
namespace {

constexpr std::uint32_t kAttentionThreads = 64;  // threads per workgroup

std::vector<Constant> make_attention_constants(std::uint32_t lanes) {
    return {{ConstantId::LANES, lanes}, {ConstantId::WORKGROUP_SIZE, kAttentionThreads}};
}

/// Describes an image slice as matrices, one per attention head, [channels, pixels] or,
/// if `transposed` is true, [pixels, channels].
shared::MatrixView view_as_head_matrices(const Slice& slice, std::uint32_t heads, bool transposed) {
    const auto pixels = std::uint32_t(slice.grid.pixels());
    return {.values = slice.view.values,
            .first = slice.view.first * pixels,
            .batch = slice.view.channels * pixels,
            .head = slice.channels / heads * pixels,
            .row = transposed ? 1 : pixels,
            .column = transposed ? pixels : 1,
            .unused = 0};
}

shared::MatrixView view_as_attention_matrices(const Tensor& shares, const Grid& grid, std::uint32_t heads,
                                              bool transposed) {
    const auto pixels = std::uint32_t(grid.pixels());
    return {.values = shares.values.address(),
            .first = 0,
            .batch = heads * pixels * pixels,
            .head = pixels * pixels,
            .row = transposed ? 1 : pixels,
            .column = transposed ? pixels : 1,
            .unused = 0};
}

}  // namespace

Attention::Attention(Device& device, std::uint32_t heads)
    : heads_(heads),
      lanes_(std::uint32_t(device.info().subgroup_size)),
      matmul_(device, "diff/network/matmul", make_attention_constants(lanes_), Subgroups::full),
      softmax_(device, "diff/network/softmax", make_attention_constants(lanes_), Subgroups::full) {}

AttentionState Attention::make_state(Device& device, const Grid& grid, bool with_gradients) const {
    const auto channels = std::uint32_t(heads_ * grid.pixels());
    AttentionState state{Tensor(device, channels, grid, "attention"), {}};
    if (with_gradients) state.d_share = Tensor(device, channels, grid, "gradient of attention");
    return state;
}

void Attention::multiply(Stream& stream, shared::MatmulParams params, const Grid& grid) const {
    params.n_batch = grid.n;
    params.n_heads = heads_;
    const std::uint32_t jobs = params.n_batch * params.n_heads * count_groups_of(params.columns, lanes_) *
                               count_groups_of(params.rows, RELIDAR_MATMUL_ROWS);
    run(stream, matmul_, std::size_t(count_groups_of(jobs, kAttentionThreads / lanes_)) * kAttentionThreads,
        params);
}

void Attention::run_softmax(Stream& stream, AttentionState& state, const Grid& grid, bool derive) const {
    const auto pixels = std::uint32_t(grid.pixels()), rows = grid.n * heads_ * pixels;
    run(stream, softmax_, std::size_t(count_groups_of(rows, kAttentionThreads / lanes_)) * kAttentionThreads,
        {.values = state.share.values.address().as<shared::SoftmaxValues>(),
         .d_values =
             (derive ? state.d_share.values.address() : Address<float>()).as<shared::SoftmaxGradients>(),
         .n_rows = rows,
         .n = pixels});
}

void Attention::forward(Stream& stream, const Slice& qkv, AttentionState& state, const Slice& output) {
    const std::uint32_t channels = output.channels, size = channels / heads_,
                        pixels = std::uint32_t(output.grid.pixels());
    RELIDAR_ASSERT_EQ(qkv.channels, 3 * channels);
    const Slice query = qkv.part(0, channels), key = qkv.part(channels, channels),
                value = qkv.part(2 * channels, channels);
    const Grid& grid = output.grid;
    multiply(stream,
             {.a = view_as_head_matrices(query, heads_, true),
              .b = view_as_head_matrices(key, heads_, false),
              .c = view_as_attention_matrices(state.share, grid, heads_, false),
              .n_batch = 0,
              .n_heads = 0,
              .rows = pixels,
              .inner = size,
              .columns = pixels,
              .scale = 1.0f / std::sqrt(float(size))},
             grid);
    run_softmax(stream, state, grid, false);
    multiply(stream,
             {.a = view_as_head_matrices(value, heads_, false),
              .b = view_as_attention_matrices(state.share, grid, heads_, true),
              .c = view_as_head_matrices(output, heads_, false),
              .n_batch = 0,
              .n_heads = 0,
              .rows = size,
              .inner = pixels,
              .columns = pixels,
              .scale = 1.0f},
             grid);
}

void Attention::vjp(Stream& stream, const Slice& qkv, AttentionState& state, const Slice& d_to,
                    const Slice& d_qkv) {
    const std::uint32_t channels = d_to.channels, size = channels / heads_,
                        pixels = std::uint32_t(d_to.grid.pixels());
    const Slice query = qkv.part(0, channels), key = qkv.part(channels, channels),
                value = qkv.part(2 * channels, channels);
    const Slice d_query = d_qkv.part(0, channels), d_key = d_qkv.part(channels, channels),
                d_value = d_qkv.part(2 * channels, channels);
    const Grid& grid = d_to.grid;
    const float scale = 1.0f / std::sqrt(float(size));
    const auto product = [&](const shared::MatrixView& first, const shared::MatrixView& second,
                             const shared::MatrixView& c, std::uint32_t rows, std::uint32_t inner,
                             float factor) {
        multiply(stream,
                 {.a = first,
                  .b = second,
                  .c = c,
                  .n_batch = 0,
                  .n_heads = 0,
                  .rows = rows,
                  .inner = inner,
                  .columns = pixels,
                  .scale = factor},
                 grid);
    };
    // computes d_value = d_to share
    product(view_as_head_matrices(d_to, heads_, false),
            view_as_attention_matrices(state.share, grid, heads_, false),
            view_as_head_matrices(d_value, heads_, false), size, pixels, 1.0f);
    // computes d_share = d_to^T value, which is then replaced by the gradient of the
    // scores
    product(view_as_head_matrices(d_to, heads_, true), view_as_head_matrices(value, heads_, false),
            view_as_attention_matrices(state.d_share, grid, heads_, false), pixels, size, 1.0f);
    run_softmax(stream, state, grid, true);
    product(view_as_head_matrices(key, heads_, false),
            view_as_attention_matrices(state.d_share, grid, heads_, true),
            view_as_head_matrices(d_query, heads_, false), size, pixels, scale);
    product(view_as_head_matrices(query, heads_, false),
            view_as_attention_matrices(state.d_share, grid, heads_, false),
            view_as_head_matrices(d_key, heads_, false), size, pixels, scale);
}

}  // namespace relidar::refine
