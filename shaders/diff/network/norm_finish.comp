// SPDX-License-Identifier: Apache-2.0
// Computes scale and shift of a batch normalisation (Ioffe and Szegedy) for each channel.
// In training, combines the mean and variance of all parts into the values of the batch
// (method of Chan). In evaluation, uses the running mean and variance instead. One thread
// per channel. Input: partial, beta_gamma. In place: running. Output: moments,
// scale_shift.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/refine.h"
RELIDAR_PARAMS(NormFinishParams);

/// Returns the mean and the variance of a channel over the batch.
vec2 batch_moments(uint channel) {
    float n = 0.0, mean = 0.0, squares = 0.0;
    uint of_image = params.n_parts / params.n_images;
    for (uint part = 0u; part < params.n_parts; ++part) {
        uint at = 2u * (part * params.n_channels + channel);
        // The first parts of an image have one pixel more if its pixels are not
        // divisible.
        float size =
            float(params.n_pixels / of_image + (part % of_image < params.n_pixels % of_image ? 1u : 0u));
        float off = params.partial.at[at] - mean, both = n + size;
        mean += off * size / both;
        squares += params.partial.at[at + 1u] + off * off * n * size / both;
        n = both;
    }
    return vec2(mean, squares / n);
}

void main() {
    uint channel = thread_index();
    if (channel >= params.n_channels) return;
    vec2 moments = params.running.at[channel];
    if (params.training != 0u) {
        vec2 batch = batch_moments(channel);
        float n = float(params.n_images * params.n_pixels);
        // The running variance is unbiased: batch variance times n / (n - 1).
        params.running.at[channel] =
            mix(moments, vec2(batch.x, batch.y * n / max(n - 1.0, 1.0)), params.momentum);
        moments = batch;
    }
    float inverse = 1.0 / sqrt(moments.y + params.epsilon);
    vec2 beta_gamma = params.beta_gamma.at[channel];
    float scale = beta_gamma.y * inverse;
    params.moments.at[channel] = vec2(moments.x, inverse);
    // gamma (x - mean) / deviation + beta, written as scale x + shift.
    params.scale_shift.at[channel] = vec2(scale, beta_gamma.x - scale * moments.x);
}
