// SPDX-License-Identifier: Apache-2.0
// Computes the inputs of the network that predicts which rays have no return (ray drop).
// The inputs do not depend on the heading of the sensor. One thread per ray. Input: rays,
// measured, channels. Output: samples.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/render.h"
RELIDAR_PARAMS(DropChannelsParams);

// Minimum probability of a return and of a drop. It limits the logits to +-9.2.
const float kLeastProbability = 1e-4;

float read_channel(uint index, uint channel) {
    MeasuredRay m = params.measured.at[index];
    if (channel == RELIDAR_DROP_LOG_RANGE) return log(1.0 + max(m.median_range_m, 0.0));
    if (channel == RELIDAR_DROP_INTENSITY) return m.intensity;
    if (channel == RELIDAR_DROP_LOGIT) {
        float p = clamp(m.drop_prob, kLeastProbability, 1.0 - kLeastProbability);
        // Inverse of p = 1 / (1 + exp(-logit)).
        return log(p / (1.0 - p));
    }
    if (channel == RELIDAR_DROP_WEIGHT) return m.weight;
    if (channel == RELIDAR_DROP_SPREAD) return log(1.0 + abs(m.median_range_m - m.mean_range_m));
    if (channel == RELIDAR_DROP_COSINE) return m.incidence;
    // The last three channels are the position of the sensor.
    return channel == RELIDAR_DROP_ELEVATION ? params.rays.at[index].direction.z
                                             : params.origin[channel - RELIDAR_DROP_ORIGIN];
}

void main() {
    uint i = thread_index();
    if (i >= params.n_rays) return;
    for (uint c = 0u; c < params.n_channels; ++c)
        params.samples.at[c * params.n_rays + i] = read_channel(i, params.channels.at[c]);
}
