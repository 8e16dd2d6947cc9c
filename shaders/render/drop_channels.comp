// SPDX-License-Identifier: Apache-2.0
// What a ray-drop network sees of the rays of an image. One thread a ray. Input: rays, measured, channels. Output: samples.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/render.h"
RELIDAR_PARAMS(DropChannelsParams);

const float kLeastProbability = 1e-4;   // of either answer: logits stay within 9.2
const float kSameSurface = 0.2;         // of the range
const uint kColumns = 4u;               // so far to either side that noise of centimetres does not tilt a surface

vec3 point(uint i) { return params.rays.at[i].origin + params.measured.at[i].median_range_m * params.rays.at[i].direction; }

/// Cosine of the angle of incidence at a pixel, from the points around it; 0 where it is not known (incidence_cosine() of core).
float incidence(uint i) {
    uint row = i / params.columns, column = i % params.columns;
    float range_m = params.measured.at[i].median_range_m;
    if (params.columns < 2u * kColumns + 1u || row == 0u || row + 1u >= params.rows || !(range_m > 0.0)) return 0.0;
    uint first = row * params.columns;
    uint around[4] = uint[](first + (column + kColumns) % params.columns, first + (column + params.columns - kColumns) % params.columns,
                            i - params.columns, i + params.columns);
    for (uint k = 0u; k < 4u; ++k) {
        float other_m = params.measured.at[around[k]].median_range_m;
        if (!(other_m > 0.0) || abs(other_m - range_m) > kSameSurface * range_m) return 0.0;
    }
    vec3 normal = cross(point(around[0]) - point(around[1]), point(around[2]) - point(around[3]));
    float size = length(normal);
    return size > 0.0 ? abs(dot(normal / size, params.rays.at[i].direction)) : 0.0;
}

float channel_of(uint i, uint channel) {
    MeasuredRay m = params.measured.at[i];
    if (channel == RELIDAR_DROP_LOG_RANGE) return log(1.0 + max(m.median_range_m, 0.0));
    if (channel == RELIDAR_DROP_INTENSITY) return m.intensity;
    if (channel == RELIDAR_DROP_LOGIT) {
        float p = clamp(m.drop_prob, kLeastProbability, 1.0 - kLeastProbability);
        return log(p / (1.0 - p));
    }
    if (channel == RELIDAR_DROP_WEIGHT) return m.weight;
    if (channel == RELIDAR_DROP_SPREAD) return log(1.0 + abs(m.median_range_m - m.mean_range_m));
    if (channel == RELIDAR_DROP_INCIDENCE) return incidence(i);
    return channel < RELIDAR_DROP_ORIGIN ? params.rays.at[i].direction[channel - RELIDAR_DROP_DIRECTION]
                                         : params.origin[channel - RELIDAR_DROP_ORIGIN];
}

void main() {
    uint i = thread_index(), n = params.rows * params.columns;
    if (i >= n) return;
    for (uint c = 0u; c < params.n_channels; ++c) params.samples.at[c * n + i] = channel_of(i, params.channels.at[c]);
}
