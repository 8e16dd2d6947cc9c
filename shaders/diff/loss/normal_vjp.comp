// SPDX-License-Identifier: Apache-2.0
// Derivative of the normal consistency (M11) through N. Each pixel gathers dL/d(point)
// from the neighbours whose tangents end at its point origin + r direction. Then applies
// the derivative of r = D / W or D. One thread per pixel. Input: rays, rendered, targets,
// d_tangents. Accumulated: upstream. Output: d_geometry (point, range).
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/geometry_loss.h"
RELIDAR_PARAMS(GeometryLossParams);
#include "range_image.glsl"

/// Returns d_tangents of a neighbour of pixel i, or 0 if the neighbour is outside the
/// image.
vec3 d_tangent(uint i, int row_offset, int column_offset, uint which) {
    uint p = pixel_at(i, row_offset, column_offset);
    return p == kNoPixel ? vec3(0.0) : params.d_tangents.at[2u * p + which];
}

void main() {
    uint i = thread_index();
    if (i >= params.n_rays || !is_surface(i)) return;  // tangents end only at surfaces
    vec3 d_point =
        d_tangent(i, 0, -1, 0u) - d_tangent(i, 0, 1, 0u) + d_tangent(i, -1, 0, 1u) - d_tangent(i, 1, 0, 1u);
    RenderedRay r = params.rendered.at[i];
    float range = image_range(i), d_range = dot(d_point, ray_of(i).direction);
    float scale = params.normalised_depth != 0u ? 1.0 / r.weight : 1.0;
    params.upstream.at[i].depth += d_range * scale;
    if (params.normalised_depth != 0u) params.upstream.at[i].weight -= d_range * range * scale;
    params.d_geometry.at[i].point = d_point;
    params.d_geometry.at[i].range = range;
}
