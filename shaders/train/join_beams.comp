// SPDX-License-Identifier: Apache-2.0
// What beams render from what the parts of their footprints do (M14): light and logits are means over the footprint; the range is that of
// the parts which explain the measurement, since a receiver reports one surface and not the mean of two. One thread a beam.
// Input: parts, part_geometry. Output: beams, beam_geometry.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/train.h"
RELIDAR_PARAMS(JoinBeamsParams);
#include "join_beams.glsl"

void main() {
    uint i = thread_index();
    if (i >= params.n_beams) return;
    uint first = i * params.n_parts;
    RenderedRay r = RenderedRay(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0u, params.parts.at[first].instance);
    RenderedGeometry q = RenderedGeometry(vec3(0.0), 0.0, 0.0, 0.0, 0.0);
    float shares = 0.0, ranges = 0.0, mean = 1.0 / float(params.n_parts);
    for (uint k = first; k < first + params.n_parts; ++k) {
        RenderedRay part = params.parts.at[k];
        float share = part_share(k);
        shares += share;
        ranges += share * part_range(part);
        r.weight += mean * part.weight;
        r.intensity += mean * part.intensity;
        r.hit_logit += mean * part.hit_logit;
        r.drop_logit += mean * part.drop_logit;
        r.transmittance += mean * part.transmittance;
        r.n_hits += part.n_hits;
        if (is_null(params.part_geometry)) continue;
        RenderedGeometry g = params.part_geometry.at[k];
        q.normal += mean * g.normal;
        q.distortion += mean * g.distortion;
        q.likelihood += mean * g.likelihood;
    }
    r.depth = r.weight * ranges / max(shares, kLeastShare);
    params.beams.at[i] = r;
    if (!is_null(params.part_geometry)) params.beam_geometry.at[i] = q;
}
