// SPDX-License-Identifier: Apache-2.0
// Copies stored samples into a batch of normalised input images for the ray-drop network.
// Shifts each image by `turn` columns, which is a rotation of the scene around the
// sensor. Channels that describe the sensor's pixels are not shifted. One thread per
// pixel. Input: samples, targets, chosen, turn, scale_shift. Output: images, start,
// target.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/refine.h"
RELIDAR_PARAMS(DropInputsParams);

void main() {
    uint i = thread_index(), n_pixels = params.rows * params.columns;
    if (i >= params.n_images * n_pixels) return;
    uint image = i / n_pixels, at = i % n_pixels, x = at % params.columns;
    // Pixel `at` shows the pixel `turn` columns to the left of it; columns wrap around.
    uint seen = at - x + (x + params.columns - params.turn.at[image] % params.columns) % params.columns,
         sampled = params.chosen.at[image];
    for (uint c = 0u; c < params.n_channels; ++c) {
        // The last n_fixed channels describe pixels of the sensor, so they do not turn.
        uint from = c + params.n_fixed < params.n_channels ? seen : at;
        float v = params.samples.at[(sampled * params.n_channels + c) * n_pixels + from];
        vec2 affine = params.scale_shift.at[c];
        params.images.at[(image * params.n_channels + c) * n_pixels + at] = affine.x * v + affine.y;
        if (c == params.logit_channel) params.start.at[i] = v;
    }
    if (!is_null(params.target)) params.target.at[i] = params.targets.at[sampled * n_pixels + seen];
}
