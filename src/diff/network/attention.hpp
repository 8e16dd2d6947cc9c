// SPDX-License-Identifier: Apache-2.0
// Multi-head self-attention (Vaswani et al.) between the pixels of small images.
#pragma once

#include "diff/network/tensor.hpp"
#include "gpu/stream.hpp"

namespace relidar::network {

struct AttentionState {
    /// Attention weights [n, heads, pixels, pixels] (softmax of the scores). A row
    /// contains the weights with which one pixel attends to all pixels.
    Tensor share;
    Tensor d_share;  ///< gradient of `share`, scratch memory of the backward pass
};

class Attention {
public:
    Attention(Device& device, std::uint32_t heads);

    AttentionState allocate_state(ImageBatchSize grid, bool with_gradients) const;
    /// Computes output[h] = V softmax(K^T Q / sqrt(channels per head)) for each head h.
    /// @param qkv query Q, key K and value V of each pixel, [n, 3 channels, rows,
    /// columns]
    /// @param output [n, channels, rows, columns]
    void attend(Stream& stream, const Slice& qkv, AttentionState& state, const Slice& output);
    void attend_vjp(Stream& s, const Slice& qkv, AttentionState& a, const Slice& d_out, const Slice& d_qkv);

private:
    static constexpr std::uint32_t kThreads = 64;  ///< threads per workgroup

    Device& device_;
    std::uint32_t heads_, lanes_ = std::uint32_t(device_.info().subgroup_size);
    std::vector<SpecialisationConstant> constants_{{SpecialisationConstantId::LANES, lanes_},
                                                   {SpecialisationConstantId::WORKGROUP_SIZE, kThreads}};
    Kernel<shared::MatmulParams> matmul_;
    Kernel<shared::SoftmaxParams> softmax_;

    void multiply(Stream& stream, const shared::MatrixView& a, const shared::MatrixView& b,
                  const shared::MatrixView& c, std::uint32_t rows, std::uint32_t inner, float scale,
                  ImageBatchSize grid) const;
    void run_softmax(Stream& stream, AttentionState& attention, ImageBatchSize grid, bool vjp) const;
};

}  // namespace relidar::network
