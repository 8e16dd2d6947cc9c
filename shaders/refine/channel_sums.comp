// SPDX-License-Identifier: Apache-2.0
// Sums over the pixels of each channel, in parts of them, one subgroup a channel and part: moments for the normalisation (mean of the part,
// then squares about it), its derivatives by beta and gamma, or plain sums.
// Input: from, d_to, scale_shift, moments. Output: partial.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "../common/kernel.glsl"
#include "../shared/refine.h"
#include "norm.glsl"
RELIDAR_CONSTANT(uint, LANES, 8u);
RELIDAR_PARAMS(ChannelSumsParams);

uint begin_of(uint part) {
    uint n = params.n_images * params.n_pixels;
    return n / params.n_parts * part + min(part, n % params.n_parts);
}

float value_at(uint pixel, uint channel) {
    return params.from.values.at[(pixel / params.n_pixels * params.from.channels + params.from.first + channel) * params.n_pixels +
                                 pixel % params.n_pixels];
}

/// dL/d(beta) and dL/d(gamma) by way of one pixel.
vec2 gradients_at(uint pixel, uint channel) {
    uint image = pixel / params.n_pixels, within = pixel % params.n_pixels;
    float x = value_at(pixel, channel);
    vec2 affine = params.scale_shift.at[channel], moments = params.moments.at[channel];
    float d = params.d_to.values.at[(image * params.d_to.channels + params.d_to.first + channel) * params.n_pixels + within];
    uint place = (image * params.n_channels + channel) * params.n_pixels + within;
    float g = d * gate(affine.x * x + affine.y, place, params.dropout_key, params.dropout);
    return vec2(g, g * (x - moments.x) * moments.y);
}

void main() {
    uint job = workgroup_index() * (gl_WorkGroupSize.x / LANES) + gl_SubgroupID, lane = gl_SubgroupInvocationID;
    uint channel = job % params.n_channels, part = min(job / params.n_channels, params.n_parts - 1u);
    uint begin = begin_of(part), end = begin_of(part + 1u);
    vec2 sum = vec2(0.0);
    for (uint i = begin + lane; i < end; i += LANES)
        sum += params.kind == kSums_norm_vjp ? gradients_at(i, channel) : vec2(value_at(i, channel), 0.0);
    sum = subgroupAdd(sum);
    if (params.kind == kSums_moments) {
        float mean = sum.x / float(max(end - begin, 1u)), squares = 0.0;
        for (uint i = begin + lane; i < end; i += LANES) {
            float off = value_at(i, channel) - mean;
            squares += off * off;
        }
        sum = vec2(mean, subgroupAdd(squares));
    }
    if (lane != 0u || job >= params.n_channels * params.n_parts) return;
    uint at = part * params.n_channels + channel;
    if (params.kind == kSums_plain) {
        params.partial.at[at] = sum.x;
    } else {
        params.partial.at[2u * at] = sum.x;
        params.partial.at[2u * at + 1u] = sum.y;
    }
}
