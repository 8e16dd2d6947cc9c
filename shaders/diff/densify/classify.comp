// SPDX-License-Identifier: Apache-2.0
// Decides what happens to each surfel during densification (docs/method.md section 6).
// Drops a surfel if it is invalid, too faint, too large, or outside the box of its actor.
// A surfel with a large gradient grows: it is cloned or split. All other surfels are
// kept. One thread per surfel of any model. Input: surfels, statistics, models, extents.
// Output: action, weight. Accumulated: counters.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../../scene/find_model.glsl"
#include "../../base/random.glsl"
#include "../shared/densify.h"
#include "../../scene/gaussian/quaternion.glsl"
RELIDAR_PARAMS(ClassifyParams);

void add_to_counter(uint model, uint counter, uint amount) {
    atomicAdd(params.counters.at[RELIDAR_DENSIFY_COUNTERS * model + counter], amount);
}

/// Returns the sum of the absolute values of `count` floats. The sum is finite only if
/// all floats are finite, so a single test is enough.
float magnitude(Floats array, uint first, uint count) {
    float sum = 0.0;
    for (uint k = 0u; k < count; ++k) sum += abs(array.at[first + k]);
    return sum;
}

bool has_third_axis() { return !is_null(params.surfels.log_scale_w); }

/// Returns true if all parameters of a surfel are finite and in their valid range.
/// @param scale standard deviations along three axes; the third is 1 for flat surfels
bool is_valid_surfel(uint surfel, vec4 quaternion, vec3 scale) {
    float sum =
        magnitude(params.surfels.mean, 3 * surfel, 3u) + magnitude(params.surfels.opacity_logit, surfel, 1u);
    sum += magnitude(params.surfels.sh, RELIDAR_SH_FLOATS * surfel, RELIDAR_SH_FLOATS);
    float q_length2 = dot(quaternion, quaternion);
    return !isnan(sum) && !isinf(sum) && q_length2 > 1e-30 && q_length2 < 1e30 &&
           all(greaterThan(scale, vec3(1e-6))) && all(lessThan(scale, vec3(1e6)));
}

/// Draws two random points from the surfel's Gaussian. Returns true if both points are
/// outside the box of its model.
bool is_outside_box(uint surfel, vec4 quaternion, vec3 scale, vec3 box_half_size) {
    if (!(box_half_size.x > 0.0)) return false;
    vec3 mean = vec3(params.surfels.mean.at[3 * surfel], params.surfels.mean.at[3 * surfel + 1],
                     params.surfels.mean.at[3 * surfel + 2]);
    mat3 r = rotation_matrix(quaternion);
    for (uint draw = 0u; draw < 2u; ++draw) {
        vec2 z = scale.xy * normal_pair(params.key, surfel, draw);
        vec3 p = mean + z.x * r[0] + z.y * r[1];
        // The last argument selects one of the surfel's random numbers. Numbers 0 and 1
        // are used above, 2 and 3 in kernel densify/spawn. Therefore this code uses 4 and
        // 5.
        if (has_third_axis()) p += scale.z * normal_pair(params.key, surfel, 4u + draw).x * r[2];
        if (!any(greaterThan(abs(p), box_half_size))) return false;
    }
    return true;
}

/// Returns how a surfel grows: clone or split if its mean gradient norm exceeds the
/// threshold, otherwise keep.
uint choose_growth(uint index, float max_scale, float extent_m) {
    uint n_seen = params.n_seen.at[index];
    if (n_seen == 0u || !(params.gradient_sum.at[index] > params.gradient_threshold * float(n_seen)))
        return RELIDAR_DENSIFY_KEEP;
    return max_scale < params.clone_extent_share * extent_m ? RELIDAR_DENSIFY_CLONE : RELIDAR_DENSIFY_SPLIT;
}

/// Returns RELIDAR_DENSIFY_KEPT if the surfel stays. Otherwise returns the reason for
/// dropping it, as the index of a counter.
uint drop_reason(uint surfel, uint model, vec4 quaternion, vec3 scale, float opacity, float max_scale) {
    if (!is_valid_surfel(surfel, quaternion, scale)) return RELIDAR_DENSIFY_INVALID;
    if (opacity < params.min_opacity) return RELIDAR_DENSIFY_FAINT;
    if (max_scale > params.max_extent_share * params.extents.at[model]) return RELIDAR_DENSIFY_LARGE;
    if (is_outside_box(surfel, quaternion, scale, params.models.at[model].half_size))
        return RELIDAR_DENSIFY_OUTSIDE;
    return RELIDAR_DENSIFY_KEPT;
}

void main() {
    uint i = thread_index();
    if (i >= params.n_surfels) return;
    uint model = find_model(params.models, params.n_models, i);
    vec4 q = vec4(params.surfels.rotation.at[4 * i], params.surfels.rotation.at[4 * i + 1],
                  params.surfels.rotation.at[4 * i + 2], params.surfels.rotation.at[4 * i + 3]);
    vec3 scale = exp(vec3(params.surfels.log_scale.at[2 * i], params.surfels.log_scale.at[2 * i + 1],
                          has_third_axis() ? params.surfels.log_scale_w.at[i] : 0.0));
    float opacity = 1.0 / (1.0 + exp(-params.surfels.opacity_logit.at[i]));
    float max_scale = max(scale.x, scale.y);
    if (has_third_axis()) max_scale = max(max_scale, scale.z);
    uint action = choose_growth(i, max_scale, params.extents.at[model]);
    // A split divides the scale by 1.6, so the following test uses the smaller scale.
    if (action == RELIDAR_DENSIFY_SPLIT) max_scale /= 1.6;
    uint why = drop_reason(i, model, q, scale, opacity, max_scale);
    // Each growing surfel requests one copy, so its weight is 1.
    uint weight = 0u;
    if (why != RELIDAR_DENSIFY_KEPT) {
        action = RELIDAR_DENSIFY_DROP;
    } else if (action != RELIDAR_DENSIFY_KEEP) {
        weight = 1u;
        add_to_counter(model,
                       action == RELIDAR_DENSIFY_CLONE ? RELIDAR_DENSIFY_CLONES : RELIDAR_DENSIFY_SPLITS, 1u);
    }
    params.action.at[i] = action;
    params.weight.at[i] = weight;
    add_to_counter(model, why, 1u);
    if (weight != 0u) add_to_counter(model, RELIDAR_DENSIFY_WEIGHT, weight);
}
