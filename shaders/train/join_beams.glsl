// SPDX-License-Identifier: Apache-2.0
// How much each part of a beam has to do with what it measured (M14). Include after params.
#ifndef RELIDAR_INCLUDED_TRAIN_JOIN_BEAMS_GLSL
#define RELIDAR_INCLUDED_TRAIN_JOIN_BEAMS_GLSL

const float kLeastWeight = 1e-3;   // a part that meets less has no range of its own
const float kLeastShare = 1e-12;   // of all parts together: nothing is divided by less

/// u of a part: the weight that lies at the measured range, and a little of all of it, for parts that explain nothing yet.
float part_share(uint part) {
    float explained = is_null(params.part_geometry) ? 0.0 : params.part_geometry.at[part].likelihood;
    return params.unexplained * params.parts.at[part].weight + explained;
}

float part_range(RenderedRay r) { return r.depth / max(r.weight, kLeastWeight); }
#endif
