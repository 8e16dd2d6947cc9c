// SPDX-License-Identifier: Apache-2.0
#include "diff/network/layers.hpp"

#include <cmath>
#include <utility>

#include "base/assert.hpp"

namespace relidar::network {
namespace {

/// Describes a slice (some channels of images) as one matrix [channels of a head, pixels]
/// per image and head. `batch`, `head`, `row` and `column` are the distances in memory
/// between images, heads, rows and columns.
HeadMatrices head_matrices(const Slice& slice, std::uint32_t n_heads) {
    const auto n_pixels = std::uint32_t(slice.grid.n_image_pixels());
    const std::uint32_t head_channels = slice.channels / n_heads;
    return {.view = {.values = slice.view.values,
                     .first = slice.view.first * n_pixels,     // view.first: first channel
                     .batch = slice.view.channels * n_pixels,  // all channels of an image
                     .head = head_channels * n_pixels,
                     .row = n_pixels,
                     .column = 1,
                     .unused = 0},  // padding
            .rows = head_channels,
            .columns = n_pixels};
}

/// Exchanges rows and columns without moving values: `row` and `column` are the distances
/// in memory between neighbouring rows and columns.
HeadMatrices transpose(HeadMatrices matrices) {
    std::swap(matrices.view.row, matrices.view.column);
    std::swap(matrices.rows, matrices.columns);
    return matrices;
}

/// Queries, keys and values of all pixels, or their gradients.
struct QueryKeyValue {
    HeadMatrices query, key, value;
};

/// Splits images with the channels of queries, keys and values.
QueryKeyValue split_qkv(const Slice& qkv, std::uint32_t n_heads) {
    const std::uint32_t n_channels = qkv.channels / 3;
    return {.query = head_matrices(qkv.channel_range(0, n_channels), n_heads),
            .key = head_matrices(qkv.channel_range(n_channels, n_channels), n_heads),
            .value = head_matrices(qkv.channel_range(2 * n_channels, n_channels), n_heads)};
}

/// Factor on the scores. It keeps their variance independent of the number of channels.
float score_scale(const HeadMatrices& query) { return 1.0f / std::sqrt(float(query.rows)); }

}  // namespace

/// Creates the kernels. Each head attends with its own part of the channels.
Attention::Attention(Device& device, std::uint32_t heads)
    : device_(device),
      heads_(heads),
      matmul_(device, "diff/network/matmul", subgroup_constants(lanes_), SubgroupRequirement::full),
      softmax_(device, "diff/network/softmax", subgroup_constants(lanes_), SubgroupRequirement::full) {}

AttentionState Attention::allocate_state(ImageBatchSize grid, bool with_gradients) const {
    // Each head has a row of weights per pixel. As an image, each such row is a channel.
    const auto channels = std::uint32_t(heads_ * grid.n_image_pixels());
    AttentionState state{Tensor(device_, channels, grid, "attention"), {}};
    if (with_gradients) state.d_share = Tensor(device_, channels, grid, "gradient of attention");
    return state;
}

/// Computes c = scale a b for each image and head. A subgroup computes a tile of c with
/// RELIDAR_MATMUL_ROWS rows, and each of its threads (lanes) one column.
void Attention::multiply(Stream& stream, std::uint32_t n_images, const HeadMatrices& a, const HeadMatrices& b,
                         const HeadMatrices& c, float scale) const {
    const std::uint32_t n_tiles = div_ceil(c.columns, lanes_) * div_ceil(c.rows, RELIDAR_MATMUL_ROWS);
    const std::uint32_t n_subgroups = n_images * heads_ * n_tiles;
    run(stream, matmul_, count_threads(n_subgroups, lanes_),
        {.a = a.view,
         .b = b.view,
         .c = c.view,
         .n_batch = n_images,
         .n_heads = heads_,
         .rows = c.rows,
         .inner = a.columns,  // equals b.rows
         .columns = c.columns,
         .scale = scale});
}

/// Replaces each row of scores in `share` by its softmax. Or, if `d_share` is not null,
/// `share` contains the softmax, and its gradients become gradients of the scores.
void Attention::run_softmax(Stream& stream, const Tensor& share, const Tensor* d_share) const {
    const auto n_pixels = std::uint32_t(share.grid.n_image_pixels());
    shared::SoftmaxParams params{};
    params.values = share.values.address().cast_tag<shared::SoftmaxValues>();
    if (d_share) params.d_values = d_share->values.address().cast_tag<shared::SoftmaxGradients>();
    params.n_rows = share.grid.n * heads_ * n_pixels;
    params.n = n_pixels;
    run(stream, softmax_, count_threads(params.n_rows, lanes_), params);  // a subgroup per row
}

void Attention::attend(Stream& stream, const Slice& qkv, AttentionState& state, const Slice& output) {
    RELIDAR_ASSERT_EQ(qkv.channels, 3 * output.channels);
    const std::uint32_t n_images = output.grid.n;
    const auto [query, key, value] = split_qkv(qkv, heads_);
    const HeadMatrices weights = head_matrices(state.share, heads_);  // [pixels, pixels]
    // scores = scale query^T key: one row per query pixel, one column per key pixel.
    multiply(stream, n_images, transpose(query), key, weights, score_scale(query));
    run_softmax(stream, state.share, nullptr);  // from scores to weights, in place
    // output = value weights^T: the weighted sum of the values of all pixels.
    multiply(stream, n_images, value, transpose(weights), head_matrices(output, heads_), 1.0f);
}

/// Backward pass of attend(), which computes weights = softmax(scale query^T key) and
/// output = value weights^T. The gradients of a product c = a b are d_a = d_c b^T and
/// d_b = a^T d_c.
void Attention::attend_vjp(Stream& stream, const Slice& qkv, AttentionState& state, const Slice& d_out,
                           const Slice& d_qkv) {
    const std::uint32_t n_images = d_out.grid.n;
    const auto [query, key, value] = split_qkv(qkv, heads_);
    const auto [d_query, d_key, d_value] = split_qkv(d_qkv, heads_);
    const HeadMatrices weights = head_matrices(state.share, heads_);
    const HeadMatrices d_weights = head_matrices(state.d_share, heads_);
    const HeadMatrices d_output = head_matrices(d_out, heads_);
    multiply(stream, n_images, d_output, weights, d_value, 1.0f);
    multiply(stream, n_images, transpose(d_output), value, d_weights, 1.0f);
    // The gradient of the softmax replaces the gradient of the weights in `d_share`.
    run_softmax(stream, state.share, &state.d_share);
    const HeadMatrices& d_scores = d_weights;
    multiply(stream, n_images, key, transpose(d_scores), d_query, score_scale(query));
    multiply(stream, n_images, query, d_scores, d_key, score_scale(query));
}

}  // namespace relidar::network
