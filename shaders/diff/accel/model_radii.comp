// SPDX-License-Identifier: Apache-2.0
// Computes the radius of a sphere around each model's origin that contains all possible
// hits. A ray query searches a moving model only if the ray intersects this sphere. Each
// thread processes RELIDAR_RADIUS_STRETCH surfels. Input: records, models. Maximum:
// radii.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../../scene/find_model.glsl"
#include "../shared/accel.h"
#include "../../scene/gaussian/kinds.glsl"
RELIDAR_PARAMS(ModelRadiiParams);

/// Returns the standard deviation of a surfel along an axis: 1 / |axis|, or 0 if this is
/// not finite.
/// @param axis_over_scale vector along the axis with the length 1 / standard deviation,
/// 1/m
float scale_along(vec3 axis_over_scale) {
    float s = 1.0 / length(axis_over_scale);
    return isnan(s) || isinf(s) ? 0.0 : s;
}

/// Returns the largest distance from the model's origin at which a ray can hit the
/// surfel. Returns 0 if the surfel can never be hit.
float compute_radius(SurfelRecord record) {
    if (!(record.opacity > params.alpha_min)) return 0.0;
    float k = sqrt(2.0 * log(record.opacity / params.alpha_min));
    float u = scale_along(record.axis_u), v = scale_along(record.axis_v),
          w = has_third_axis() ? scale_along(record.normal) : 0.0;
    float radius = (length(record.mean) + k * max(max(u, v), w)) * params.margin_scale + params.margin_m;
    return isnan(radius) || isinf(radius) ? 3.4e38 : radius;
}

void extend_radius(uint model, float radius) {
    if (radius > 0.0) atomicMax(params.radii.at[model], floatBitsToUint(radius));
}

void main() {
    uint first = thread_index() * RELIDAR_RADIUS_STRETCH;
    if (first >= params.n_surfels) return;
    uint model = find_model(params.models, params.n_models, params.first_surfel + first);
    float radius = 0.0;
    for (uint k = first; k < min(first + RELIDAR_RADIUS_STRETCH, params.n_surfels); ++k) {
        uint surfel = params.first_surfel + k;
        if (surfel - params.models.at[model].first_surfel >= params.models.at[model].n_surfels) {
            // This surfel belongs to a later model, so the radius is complete.
            extend_radius(model, radius);
            radius = 0.0;
            model = find_model(params.models, params.n_models, surfel);
        }
        radius = max(radius, compute_radius(params.records.at[surfel]));
    }
    extend_radius(model, radius);
}
