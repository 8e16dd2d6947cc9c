// SPDX-License-Identifier: Apache-2.0
// Backward pass (Eq. 9; M7, M8): casts the same rays again, front to back, and adds the gradient of every hit to its surfel's
// record gradient. One thread a ray.
// Input: scene, rendered, upstream. Accumulated: d_records, d_sh (where SH are evaluated a hit). Output: d_rays.
// @differs Eq. 8 as printed lacks the factor 1 / (1 - alpha) on the sum; Eq. 9 has it and is right. The background needs no term
// of its own: it is in the final value that Eq. 9 subtracts from.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_shader_atomic_float : enable
#include "../traversal/includes.glsl"
#include "../common/atomic_add.glsl"
#include "../common/compensated.glsl"
RELIDAR_PARAMS(BackwardParams);

vec3 d_ray_origin;      // world
vec3 d_ray_direction;

void add3(Floats array, uint index, vec3 g) {
    atomic_add(array, index, g.x);
    atomic_add(array, index + 1u, g.y);
    atomic_add(array, index + 2u, g.z);
}

void add_record_gradient(uint surfel, SurfelHitGradient g, vec3 d_channel) {
    uint row = surfel * 16u;
    add3(params.d_records, row, g.d_mean);
    atomic_add(params.d_records, row + 3u, g.d_opacity);
    add3(params.d_records, row + 4u, g.d_axis_u);
    add3(params.d_records, row + 8u, g.d_axis_v);
    add3(params.d_records, row + 12u, g.d_normal);
    if (SH_PER_SURFEL == 0u) return;
    atomic_add(params.d_records, row + 7u, d_channel.x);
    atomic_add(params.d_records, row + 11u, d_channel.y);
    atomic_add(params.d_records, row + 15u, d_channel.z);
}

/// Gradient of the SH coefficients of one hit, and through the basis to the ray's direction.
void add_sh_gradient(TraceScene scene, InstanceEntry m, vec3 direction, uint surfel, vec3 d_channel, float intensity) {
    if (!(intensity > 0.0)) d_channel.x = 0.0;   // clamped
    float d_basis[16];
    for (uint k = 0u; k < 16u; ++k) d_basis[k] = 0.0;
    for (uint c = 0u; c < 3u; ++c)
        for (uint k = 0u; k < sh_count(scene.sh_degree); ++k) {
            uint slot = surfel * RELIDAR_SH_FLOATS + c * RELIDAR_SH_COEFFICIENTS + k;
            atomic_add(params.d_sh, slot, d_channel[c] * ray_basis[k]);
            d_basis[k] += d_channel[c] * scene.sh.at[slot];
        }
    d_ray_direction += world_vector(m, sh_basis_vjp(direction, scene.sh_degree, d_basis));
}

/// A hit as it was blended.
struct BlendedHit {
    uint instance;
    uint surfel;
    float transmittance;   // before it
    float w;               // alpha times that
    float intensity;
    float shade;           // g . c less the shift
    float behind;          // sum of w shade over the hits behind it, background included
};

void add_hit(TraceScene scene, Ray ray, RayGradient g, BlendedHit blended) {
    InstanceEntry m = scene.instances.at[blended.instance];
    SurfelRecord record = scene.records.at[blended.surfel];
    enter_instance(scene, ray, blended.instance);
    vec3 origin = entered_origin, direction = entered_direction;
    SurfelHit hit;
    intersect(record, origin, direction, hit);
    float alpha = min(hit.alpha, scene.alpha_max);
    float d_alpha = hit.alpha > scene.alpha_max ? 0.0 : blended.transmittance * blended.shade - blended.behind / (1.0 - alpha);   // Eq. 9
    SurfelHitGradient d = intersect_vjp(record, origin, direction, hit, g.depth * blended.w, d_alpha);
    vec3 d_channel = blended.w * vec3(g.intensity, g.hit_logit, g.drop_logit);
    add_record_gradient(blended.surfel, d, d_channel);
    d_ray_origin += world_vector(m, d.d_origin);
    d_ray_direction += world_vector(m, d.d_direction);
    if (SH_PER_SURFEL == 0u) add_sh_gradient(scene, m, direction, blended.surfel, d_channel, blended.intensity);
}

// One chunk as it was blended, so that what lies behind a hit is summed back to front instead of by subtracting two long sums: no
// digits are lost where 1 / (1 - alpha) is large.
float chunk_transmittance[CHUNK];
float chunk_w[CHUNK];
float chunk_shade[CHUNK];
float chunk_intensity[CHUNK];

/// g . c of a hit in the buffer: what a unit of its weight is worth to the loss.
float shade_of(TraceScene scene, Ray ray, RayGradient g, uint i, out float intensity) {
    vec3 c = hit_channels(scene, ray, hit_instance[i], hit_surfel[i], scene.records.at[hit_surfel[i]]);
    intensity = c.x;
    return g.depth * hit_t[i] + g.weight + g.intensity * c.x + g.hit_logit * c.y + g.drop_logit * c.z;
}

/// What is carried from chunk to chunk.
struct BlendState {
    float shift;
    float transmittance;
    float remaining;   // share of the loss of everything not blended yet, background included
    float lost;        // what rounding took from it
};

/// Blends the hits in the buffer front to back, n of them, and takes their share of the loss from what remains.
void blend_chunk(TraceScene scene, Ray ray, RayGradient g, uint n, inout BlendState state) {
    for (uint i = 0u; i < n; ++i) {
        float alpha = min(hit_alpha[i], scene.alpha_max);
        chunk_transmittance[i] = state.transmittance;
        chunk_w[i] = alpha * state.transmittance;
        chunk_shade[i] = shade_of(scene, ray, g, i, chunk_intensity[i]) - state.shift;
        add_compensated(state.remaining, state.lost, -chunk_w[i] * chunk_shade[i]);
        state.transmittance *= 1.0 - alpha;
    }
}

void backward(TraceScene scene, Ray ray, RenderedRay final, RayGradient g) {
    precise float remaining = g.depth * final.depth;
    remaining += g.weight * final.weight + g.intensity * final.intensity + g.hit_logit * final.hit_logit + g.drop_logit * final.drop_logit;
    // Eq. 9 does not change when the same number is taken from every value and from the background's, for all weights sum to 1.
    // With the nearest surface's worth as that number, small differences are no longer differences of large numbers.
    BlendState state = BlendState(0.0, 1.0, remaining, 0.0);
    uint blended = 0u;
    Key after = first_key(scene);
    for (uint pass = 0u; pass < RELIDAR_MAX_PASSES && blended < final.n_hits; ++pass) {
        next_hits(scene, ray, after, remaining_budget(scene, state.transmittance));
        uint n = min(n_hits, final.n_hits - blended);
        if (pass == 0u) {
            float unused;
            state.shift = shade_of(scene, ray, g, 0u, unused);
            add_compensated(state.remaining, state.lost, -state.shift * final.weight);
            add_compensated(state.remaining, state.lost, -state.shift * final.transmittance);
        }
        blended += n;
        blend_chunk(scene, ray, g, n, state);
        bool ends = blended == final.n_hits || !hits_closed;
        float behind = ends ? state.transmittance * (g.drop_logit - state.shift) : state.remaining;   // background: drop logit 1
        for (uint k = n; k > 0u; --k) {
            uint i = k - 1u;
            use_basis(scene, ray, hit_instance[i]);
            add_hit(scene, ray, g, BlendedHit(hit_instance[i], hit_surfel[i], chunk_transmittance[i], chunk_w[i], chunk_intensity[i], chunk_shade[i], behind));
            behind += chunk_w[i] * chunk_shade[i];
        }
        if (ends) return;
        after = hit_key(n_hits - 1u);
    }
}

void main() {
    uint i = traced_ray(params.scene);
    if (i >= params.scene.n_rays) return;
    RayEntry entry = params.scene.rays.at[params.scene.first_ray + i * params.scene.ray_stride];
    d_ray_origin = vec3(0.0);
    d_ray_direction = vec3(0.0);
    ray_basis_instance = kNoInstance;
    RayGradient g = params.upstream.at[i];
    bool any_gradient = g.depth != 0.0 || g.weight != 0.0 || g.intensity != 0.0 || g.hit_logit != 0.0 || g.drop_logit != 0.0;
    if (any_gradient) backward(params.scene, Ray(entry.origin, entry.direction), params.rendered.at[i], g);
    if (uint64_t(params.d_rays) == 0ul) return;
    for (uint c = 0u; c < 3u; ++c) {
        params.d_rays.at[6u * i + c] = d_ray_origin[c];
        params.d_rays.at[6u * i + 3u + c] = d_ray_direction[c];
    }
}
