// SPDX-License-Identifier: Apache-2.0
// Updates the statistics for densification: the gradient norm with respect to the mean,
// summed over batches, and the number of batches in which the surfel was visible. One
// thread per surfel. Input: d_mean, touched. Accumulated: gradient_sum, n_seen, frames.
//
// A batch that contains every s-th ray of a frame may miss a small visible surfel, and
// gives s times larger gradients to the surfels that it hits. Therefore a batch counts
// for every surfel that has ever had a gradient in the same frame, so that the mean over
// batches equals the mean over full frames.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/densify.h"
RELIDAR_PARAMS(ObserveParams);

void main() {
    uint i = thread_index();
    if (i >= params.n_surfels) return;
    // Bit of this frame in the set of frames in which the surfel had a gradient.
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
