// SPDX-License-Identifier: Apache-2.0
// Rays over the footprints of beams: each beam's own target for all of its parts. One thread a part.
// Input: beams, beam_targets, offsets. Output: parts, part_targets.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/train.h"
RELIDAR_PARAMS(SplitBeamsParams);

void main() {
    uint k = thread_index();
    if (k >= params.n_beams * params.n_parts) return;
    uint i = params.first_beam + k / params.n_parts * params.beam_stride;
    DeviceRay beam = params.beams.at[i];
    vec3 helper = abs(beam.direction.z) < 0.9 ? vec3(0.0, 0.0, 1.0) : vec3(1.0, 0.0, 0.0);
    vec3 left = normalize(cross(helper, beam.direction)), up = cross(beam.direction, left);
    vec2 across = tan(params.half_divergence * params.offsets.at[k % params.n_parts]);
    params.parts.at[k] = DeviceRay(beam.origin, normalize(beam.direction + across.x * left + across.y * up));
    params.part_targets.at[k] = params.beam_targets.at[i];
}
