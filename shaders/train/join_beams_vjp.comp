// SPDX-License-Identifier: Apache-2.0
// Derivative of join_beams: gradients of parts from those of their beams. With R = sum u_k r_k / sum u_k the range of a beam, r_k =
// D_k / W_k those of its parts and W the mean of the W_k, D = R W. One thread a part.
// Input: parts, part_geometry, beams, d_beams, d_beam_geometry. Output: d_parts, d_part_geometry.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/train.h"
RELIDAR_PARAMS(JoinBeamsParams);
#include "join_beams.glsl"

void main() {
    uint k = thread_index();
    if (k >= params.n_beams * params.n_parts) return;
    uint i = k / params.n_parts, first = i * params.n_parts;
    float shares = 0.0, mean = 1.0 / float(params.n_parts);
    for (uint p = first; p < first + params.n_parts; ++p) shares += part_share(p);
    shares = max(shares, kLeastShare);
    RenderedRay beam = params.beams.at[i], part = params.parts.at[k];
    RayGradient d = params.d_beams.at[i];
    float range = beam.weight > 0.0 ? beam.depth / beam.weight : 0.0;
    float d_range = d.depth * beam.weight, weight = max(part.weight, kLeastWeight);
    float d_part_range = d_range * part_share(k) / shares, d_share = d_range * (part_range(part) - range) / shares;
    float d_weight = mean * (d.weight + d.depth * range) + params.unexplained * d_share;
    if (part.weight > kLeastWeight) d_weight -= d_part_range * part.depth / (weight * weight);
    params.d_parts.at[k] = RayGradient(d_part_range / weight, d_weight, mean * d.intensity, mean * d.hit_logit, mean * d.drop_logit);
    if (is_null(params.part_geometry)) return;
    GeometryGradient g = params.d_beam_geometry.at[i];
    params.d_part_geometry.at[k] =
        GeometryGradient(mean * g.normal, mean * g.distortion, mean * g.point, mean * g.range, mean * g.likelihood + d_share);
}
