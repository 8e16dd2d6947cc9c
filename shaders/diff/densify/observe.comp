// SPDX-License-Identifier: Apache-2.0
// Statistics that densification decides by: the norm of the gradient with respect to the
// mean, summed over batches, and in how many batches the surfel was seen. The gradient is
// of the mean in the model's frame; that frame is placed rigidly, so the norm is the
// world's. One thread a surfel. Input: d_mean, touched. Accumulated: gradient_sum,
// n_seen, frames. A batch that is a subset of its frame's rays (every s-th) may miss a
// small surfel that the frame shows; the gradients of the others are larger by s, because
// the loss is a mean over the batch. So a batch counts as having seen every surfel that
// has ever had a gradient in its frame: the mean over batches is then that of whole
// frames, however few rays a batch has.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/densify.h"
RELIDAR_PARAMS(ObserveParams);

void main() {
    uint i = thread_index();
    if (i >= params.n_surfels) return;
    uint word = i * params.n_words + params.frame / 32u;
    uint bit = 1u << (params.frame % 32u);
    uint frames = params.frames.at[word];
    bool touched = params.touched.at[i] != 0u;
    if (touched) {
        vec3 d_mean = vec3(params.d_mean.at[3 * i], params.d_mean.at[3 * i + 1], params.d_mean.at[3 * i + 2]);
        params.gradient_sum.at[i] += length(d_mean);
        params.frames.at[word] = frames | bit;
    }
    if (touched || (params.whole_frame == 0u && (frames & bit) != 0u)) params.n_seen.at[i] += 1u;
}
