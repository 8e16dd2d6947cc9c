// SPDX-License-Identifier: Apache-2.0
// Sums over the pixels of each channel of a batch of images. The pixels are split into
// parts, and one subgroup processes one part of one channel. A constant selects the sums:
// mean and squared deviations for batch normalisation, derivatives with respect to beta
// and gamma, or plain sums. Input: from, d_to, scale_shift, moments. Output: partial.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/refine.h"
#include "norm.glsl"
RELIDAR_CONSTANT(uint, LANES, 8u);
RELIDAR_PARAMS(ChannelSumsParams);

/// Returns the first pixel of part number `part` of an image. Each image is divided into
/// `parts_per_image` parts of nearly equal size.
uint first_pixel(uint part, uint parts_per_image) {
    return params.n_pixels / parts_per_image * part + min(part, params.n_pixels % parts_per_image);
}

/// Returns one pixel's contribution to dL/d(beta) and dL/d(gamma) of the normalisation.
/// @param first_value,first_gradient index of the channel's first pixel in params.from
/// and params.d_to
/// @param first_dropout_index index of the channel's first pixel in the dropout mask
/// @param scale_shift,mean_and_inverse_deviation (scale, shift) and (mean, 1 / deviation)
/// of the channel
vec2 norm_gradients(uint pixel, uint first_value, uint first_gradient, uint first_dropout_index,
                    vec2 scale_shift, vec2 mean_and_inverse_deviation) {
    float x = params.from.values.at[first_value + pixel];
    float passes = relu_dropout(scale_shift.x * x + scale_shift.y, first_dropout_index + pixel,
                                params.dropout_key, params.dropout);
    float g = params.d_to.values.at[first_gradient + pixel] * passes;
    return vec2(g, g * (x - mean_and_inverse_deviation.x) * mean_and_inverse_deviation.y);
}

void main() {
    // One job is one part of one channel. Surplus subgroups repeat the last part, but
    // store nothing.
    uint job = workgroup_index() * (gl_WorkGroupSize.x / LANES) + gl_SubgroupID,
         lane = gl_SubgroupInvocationID;
    uint channel = job % params.n_channels, part = min(job / params.n_channels, params.n_parts - 1u);
    uint parts_per_image = params.n_parts / params.n_images, image = part / parts_per_image;
    uint begin = first_pixel(part % parts_per_image, parts_per_image),
         end = first_pixel(part % parts_per_image + 1u, parts_per_image);
    // Index of the first value of this channel of this image.
    uint plane = (image * params.from.channels + params.from.first + channel) * params.n_pixels;
    vec2 sum = vec2(0.0);
    if (params.kind == kNormVjpSums) {
        uint d_plane = (image * params.d_to.channels + params.d_to.first + channel) * params.n_pixels;
        uint place = (image * params.n_channels + channel) * params.n_pixels;
        vec2 affine = params.scale_shift.at[channel], moments = params.moments.at[channel];
        for (uint i = begin + lane; i < end; i += LANES)
            sum += norm_gradients(i, plane, d_plane, place, affine, moments);
    } else {
        for (uint i = begin + lane; i < end; i += LANES) sum.x += params.from.values.at[plane + i];
    }
    sum = subgroupAdd(sum);
    if (params.kind == kMomentSums) {
        // Mean and squared deviations from it. Kernel norm_finish combines the parts.
        float mean = sum.x / float(max(end - begin, 1u)), squares = 0.0;
        for (uint i = begin + lane; i < end; i += LANES) {
            float off = params.from.values.at[plane + i] - mean;
            squares += off * off;
        }
        sum = vec2(mean, subgroupAdd(squares));
    }
    if (lane != 0u || job >= params.n_channels * params.n_parts) return;
    uint at = part * params.n_channels + channel;
    if (params.kind == kPlainSums) {
        params.partial.at[at] = sum.x;
    } else {
        params.partial.at[2u * at] = sum.x;
        params.partial.at[2u * at + 1u] = sum.y;
    }
}
