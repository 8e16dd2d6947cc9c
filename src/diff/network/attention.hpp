// SPDX-License-Identifier: Apache-2.0
// Multi-head self-attention (Vaswani et al.) between the pixels of small images.
#pragma once

#include "diff/network/tensor.hpp"
#include "gpu/stream.hpp"

namespace relidar::refine {

/// Intermediate results of the forward pass that the backward pass needs.
struct AttentionState {
    /// [n, heads, pixels, pixels]: softmax of the scores. Each row holds the attention
    /// weights of one query pixel.
    Tensor share;
    Tensor d_share;  ///< same shape, scratch of the backward pass
};

class Attention {
public:
    /// Creates the kernels for attention.
    /// @param heads  number of heads. The channels are divided equally between them.
    Attention(Device& device, std::uint32_t heads);

    AttentionState make_state(Device& device, const Grid& grid, bool with_gradients) const;
    /// Computes to[h] = V softmax(K^T Q / sqrt(channels per head)) for each head h.
    /// @param qkv  [n, 3 channels, rows, columns] query, key and value of each pixel
    /// @param to  [n, channels, rows, columns]
    void forward(Stream& stream, const Slice& qkv, AttentionState& state, const Slice& to);
    void vjp(Stream& stream, const Slice& qkv, AttentionState& state, const Slice& d_to, const Slice& d_qkv);

private:
    std::uint32_t heads_, lanes_;
    Kernel<shared::MatmulParams> matmul_;
    Kernel<shared::SoftmaxParams> softmax_;

    void multiply(Stream& stream, shared::MatmulParams params, const Grid& grid) const;
    void run_softmax(Stream& stream, AttentionState& state, const Grid& grid, bool derive) const;
};

}  // namespace relidar::refine
