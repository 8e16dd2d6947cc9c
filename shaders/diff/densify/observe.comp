// SPDX-License-Identifier: Apache-2.0
// Updates the statistics for densification: the norm of the gradient with respect to the
// mean, summed over batches, and the number of batches in which the surfel was visible.
// The gradient is in the model's frame. A model is placed by a rigid transform, so the
// norm is the same in the world. One thread per surfel. Input: d_mean, touched.
// Accumulated: gradient_sum, n_seen, frames.
//
// A batch of every s-th ray of a frame may miss a small surfel that is visible in the
// frame. The gradients of the other surfels are larger by the factor s, because the loss
// is a mean over the batch. So a batch counts as visible for every surfel that has ever
// had a gradient in the batch's frame. The mean over batches is then the mean over full
// frames, whatever the number of rays in a batch.
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
    if (touched || (params.is_full_frame == 0u && (frames & bit) != 0u)) params.n_seen.at[i] += 1u;
}
