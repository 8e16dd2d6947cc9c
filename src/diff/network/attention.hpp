// SPDX-License-Identifier: Apache-2.0
// Multi-head self-attention (Vaswani et al.) among the pixels of small images.
#pragma once

#include "diff/network/tensor.hpp"
#include "gpu/stream.hpp"

namespace relidar::refine {

/// What a pass keeps for the way back.
struct AttentionState {
    Tensor share;    ///< [n, heads, pixels, pixels] softmax of the scores: what a pixel (row) takes from each
    Tensor d_share;  ///< the same shape, scratch of the way back
};

class Attention {
public:
    /// @param heads  between which the channels are divided
    Attention(Device& device, std::uint32_t heads);

    AttentionState make_state(Device& device, const Grid& grid, bool with_gradients) const;
    /// to[h] = V softmax(K^T Q / sqrt(channels of a head))  for each head h.
    /// @param qkv [n, 3 channels, rows, columns] query, key and value of each pixel
    /// @param to [n, channels, rows, columns]
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
