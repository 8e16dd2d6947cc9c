// SPDX-License-Identifier: Apache-2.0
// Backward pass of the renderer (paper, Eq. 9; docs/method.md M7, M8). Finds the hits of
// each ray again, or loads the hits that the forward pass has stored, front to back. Adds
// the gradient of each hit to its surfel's record gradient, or writes the hit to a list
// for backward/gather. One thread per ray.
//
// Input: scene, rendered, upstream, kept, first_hit. Accumulated: d_records, d_sh (if SH
// are evaluated per hit). Output: touched, d_rays, hits, rows.
//
// @differs Eq. 8 of the paper lacks the factor 1 / (1 - alpha) on the sum. Eq. 9 has this
// factor and is correct. The background needs no separate term, because the blended value
// that Eq. 9 starts with includes it.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../traversal/includes.glsl"
#include "relidar/base/atomic_add.glsl"
#include "../../base/compensated.glsl"
#include "../shared/backward.h"
#include "hit_gradient.glsl"
#include "blend_gradient.glsl"
#include "add_row.glsl"
RELIDAR_PARAMS(BackwardParams);

RELIDAR_CONSTANT(uint, GATHER, 0u);

vec3 d_ray_origin;  // gradient of the ray's origin, world frame
vec3 d_ray_direction;

/// Adds the gradient of a hit to the gradient of its surfel.
/// @param row row of the surfel in `d_records`, or kNoRow if this thread has no hit
void add_gradient(TraceScene scene, uint row, uint surfel, HitGradient gradient) {
    bool others = SH_PER_SURFEL != 0u || params.with_turn != 0u;  // lanes 7, 11, 15
    for (uint k = 0u; k < 16u; ++k)
        if (others || k % 4u != 3u || k == 3u) add_to_row(params.d_records, row, k, gradient.lanes[k]);
    add_rows(params.d_records, row, others ? 0xffffu : 0x777fu);
    if (SH_PER_SURFEL != 0u) return;
    uint n = count_sh(scene.sh_degree);
    for (uint c = 0u; c < 3u; ++c) {
        uint sh_row = row == kNoRow ? kNoRow : 3u * surfel + c;
        for (uint k = 0u; k < n; ++k)
            add_to_row(params.d_sh, sh_row, k, gradient.d_channel[c] * ray_basis[k]);
        add_rows(params.d_sh, sh_row, (1u << n) - 1u);
    }
}

struct BlendedHit {
    uint slot;  // index of the hit's record in `hits`
    uint instance;
    uint surfel;
    float alpha;          // Opacity at the hit (sigma G) before it is clamped.
    float transmittance;  // transmittance before the hit
    float w;              // alpha times transmittance
    // dL/dw of this hit minus dL/dw of the ray's nearest hit, where L is the loss. Sums
    // of these small differences have smaller rounding errors than sums of dL/dw.
    float shade;
    float behind;  // Sum of weight times `shade` over all hits behind this hit, including the background.
};

/// Computes the gradient of one hit and adds it to the gradient of the ray. With GATHER,
/// stores the hit for kernel backward/gather. Otherwise adds the gradient to the surfel.
/// If exchanges_rows(), the caller must add it with add_gradient() instead.
/// @param hit_gradient output: gradient of the hit
/// @return row of the surfel in `d_records`, or kNoRow if the hit was stored
uint add_hit_gradient(TraceScene scene, Ray ray, uint ray_index, RayGradient gradient, BlendedHit blended_hit,
                      out HitGradient hit_gradient) {
    uint first_surfel = scene.instances.at[blended_hit.instance].first_surfel;
    uint row = blended_hit.surfel - first_surfel + scene.instances.at[blended_hit.instance].first_row;
    if (!is_null(params.touched)) params.touched.at[blended_hit.surfel] = 1u;
    // Eq. 9. A clamped alpha does not depend on the surfel, so its gradient is 0.
    float d_alpha = blended_hit.alpha > scene.alpha_max ? 0.0
                                                        : blended_hit.transmittance * blended_hit.shade -
                                                              blended_hit.behind / (1.0 - blended_hit.alpha);
    bool recorded = GATHER != 0u && blended_hit.slot < params.capacity;
    if (recorded) {
        params.hits.at[blended_hit.slot] = HitRecord(ray_index, blended_hit.instance, blended_hit.w, d_alpha);
        params.rows.at[blended_hit.slot] = row;
        if (is_null(params.d_rays)) return kNoRow;
    }
    hit_gradient =
        hit_vjp(scene, ray, gradient, blended_hit.instance, blended_hit.surfel, blended_hit.w, d_alpha);
    if (!recorded && !exchanges_rows()) add_gradient(scene, row, blended_hit.surfel, hit_gradient);
    d_ray_origin += rotate_to_world(scene, hit_gradient.d_origin);
    d_ray_direction += rotate_to_world(scene, hit_gradient.d_direction);
    return recorded ? kNoRow : row;
}

/// Loads the next hits that the forward pass has stored for this ray into the hit buffer.
void load_kept_hits(uint first, uint count) {
    uint list = thread_index();
    reset_hits(0.0);
    hits_closed = true;
    for (uint i = 0u; i < min(count, CHUNK); ++i)
        append_hit(params.kept.at[hit_list_index(params.n_kept, list, first + i)]);
}

/// Adds the gradients of the first `hit_count` hits in the hit buffer, from far to near.
/// If exchanges_rows(), all threads of the subgroup must call this function.
/// @param first_record index in `hits` of the record of the first hit
/// @param sum_behind sum of w * shade (see BlendedHit) over farther hits and background
void add_buffered_hits(TraceScene scene, Ray ray, uint ray_index, RayGradient gradient, uint first_record,
                       uint hit_count, float sum_behind) {
    for (uint k = exchanges_rows() ? subgroupMax(hit_count) : hit_count; k > 0u; --k) {
        uint i = k - 1u, row = kNoRow, surfel = 0u;
        HitGradient d;
        if (k <= hit_count) {
            Hit hit = load_hit(i);
            surfel = hit.surfel;
            row = add_hit_gradient(scene, ray, ray_index, gradient,
                                   BlendedHit(first_record + i, hit.instance, hit.surfel, hit.alpha,
                                              chunk_transmittance[i], chunk_w[i], chunk_shade[i], sum_behind),
                                   d);
            sum_behind += chunk_w[i] * chunk_shade[i];
        }
        if (exchanges_rows()) add_gradient(scene, row, surfel, d);
    }
}

/// Returns the state in which the backward pass starts to blend the hits of a ray again.
/// `remaining` is the sum of value * dL/d(value) over all blended values of the ray.
BlendState backward_state(RenderedRay rendered, RayGradient gradient) {
#define RELIDAR_REMAINS(name, built, value, input, slope, meaning) +gradient.name* rendered.name
    precise float remaining = RELIDAR_CHANNEL_VALUES(RELIDAR_REMAINS);
#undef RELIDAR_REMAINS
    remaining += gradient.depth * rendered.depth;
    BlendState state = BlendState(0.0, 1.0, remaining, 0.0);
#define RELIDAR_REMAINS(name, built, value, input, slope, meaning) \
    if (built) state.remaining += gradient.name * rendered.name;
    RELIDAR_LOSS_VALUES(RELIDAR_REMAINS)
#undef RELIDAR_REMAINS
    return state;
}

/// Subtracts dL/dw of the nearest hit from dL/dw of all hits, which reduces rounding
/// errors. The blending weights w sum to 1, so a common offset changes no gradient.
void subtract_nearest(TraceScene scene, Ray ray, RenderedRay rendered, RayGradient gradient,
                      inout BlendState state) {
    state.shift = weight_gradient(scene, ray, gradient, load_hit(0u));
    kahan_add(state.remaining, state.lost, -state.shift * rendered.weight);
    kahan_add(state.remaining, state.lost, -state.shift * rendered.transmittance);
}

/// Computes the gradients of all hits of a ray.
/// @param is_active false if this thread has no ray or the gradient of its ray is zero.
/// Such a thread must also call this function if exchanges_rows() is true
/// @return number of hits whose gradients were computed. Less than rendered.n_hits if the
/// backward pass does not find all hits of the forward pass again
uint backpropagate_ray(TraceScene scene, Ray ray, uint ray_index, RenderedRay rendered, RayGradient gradient,
                       bool is_active) {
    BlendState state = backward_state(rendered, gradient);
    uint blended = 0u, start = GATHER != 0u ? params.first_hit.at[ray_index] : 0u;
    HitKey previous_key = search_start_key(scene);
    is_active = is_active && rendered.n_hits > 0u;
    for (uint pass = 0u; pass < RELIDAR_MAX_PASSES && (exchanges_rows() ? subgroupAny(is_active) : is_active);
         ++pass) {
        uint n = 0u, slot = start + blended;
        float behind = 0.0;
        if (is_active) {
            // True if the forward pass has stored all hits of the next chunk. Otherwise,
            // all of them are searched again. Thus n_kept, the number of stored hits,
            // does not change the division into chunks and the rounding errors.
            bool kept = min(blended + CHUNK, rendered.n_hits) <= params.n_kept;
            if (kept) load_kept_hits(blended, rendered.n_hits - blended);
            else find_next_hits(scene, ray, previous_key, transmittance_limit(scene, state.transmittance));
            n = min(n_hits, rendered.n_hits - blended);
            if (pass == 0u) subtract_nearest(scene, ray, rendered, gradient, state);
            blended += n;
            blend_hit_chunk(scene, ray, gradient, n, state);
            is_active = blended < rendered.n_hits && hits_closed;
            // the background has drop logit 1
            behind = is_active ? state.remaining : state.transmittance * (gradient.drop_logit - state.shift);
            if (is_active) previous_key = load_hit_key(n_hits - 1u);
        }
        add_buffered_hits(scene, ray, ray_index, gradient, slot, n, behind);
    }
    return blended;
}

/// Marks the reserved records of hits that were not processed as unused, so that the sort
/// moves them to the end.
void clear_records(uint ray_index, uint first, uint count) {
    uint start = params.first_hit.at[ray_index];
    for (uint k = start + first; k < min(start + count, params.capacity); ++k)
        params.rows.at[k] = RELIDAR_NO_ROW(params.n_rows);
}

void main() {
    uint i = traced_ray(params.scene);
    bool inside = i < params.scene.n_rays;
    if (!inside) {
        if (!exchanges_rows()) return;
        // All lanes must take part in the exchange of gradients, so a lane without a ray
        // uses ray 0 as a placeholder.
        i = 0u;
    }
    DeviceRay entry = params.scene.rays.at[params.scene.first_ray + i * params.scene.ray_stride];
    d_ray_origin = vec3(0.0);
    d_ray_direction = vec3(0.0);
    ray_basis_instance = kNoInstance;
    RayGradient g = params.upstream.at[i];
    RenderedRay final = params.rendered.at[i];
    if (LIKELIHOOD != 0u) cache_range(params.scene, i);
    uint blended = backpropagate_ray(params.scene, make_ray(entry), i, final, g, inside && has_gradient(g));
    if (!inside) return;
    if (GATHER != 0u) clear_records(i, blended, final.n_hits);
    if (is_null(params.d_rays)) return;
    for (uint c = 0u; c < 3u; ++c) {
        params.d_rays.at[6u * i + c] = d_ray_origin[c];
        params.d_rays.at[6u * i + 3u + c] = d_ray_direction[c];
    }
}
