// SPDX-License-Identifier: Apache-2.0
// Repeats the blending of the forward pass, chunk by chunk, to compute the share of each
// hit in the loss (M7). Stores the blended values of one chunk. So the sum behind a hit
// is computed back to front instead of as a difference of two long sums. This keeps the
// precision where 1 / (1 - alpha) is large.
#ifndef RELIDAR_INCLUDED_DIFF_BACKWARD_BLEND_GRADIENT_GLSL
#define RELIDAR_INCLUDED_DIFF_BACKWARD_BLEND_GRADIENT_GLSL
float chunk_transmittance[SLOTS];
float chunk_w[SLOTS];
float chunk_shade[SLOTS];

/// State that is passed from chunk to chunk.
struct BlendState {
    float shift;
    float transmittance;
    float remaining;  // share of the loss that is not blended yet, including the background
    float lost;       // rounding error of `remaining`
    float first_t;    // distance of the ray's first hit (this and later fields: only with geometry)
    float before;     // sum of w (t - first_t) over the blended hits
    float moment;     // the same sum over all hits of the ray
};

/// Returns g . c of a hit, the derivative of the loss with respect to the hit's weight.
float shade_of(TraceScene scene, Ray ray, RayGradient g, Hit hit, BlendState state) {
    vec3 c = hit_channels(scene, ray, hit.instance, hit.surfel, scene.records.at[hit.surfel]);
    float shade = g.depth * hit.t + g.weight + g.intensity * c.x + g.hit_logit * c.y + g.drop_logit * c.z;
    if (LIKELIHOOD != 0u) shade += ray_geometry.likelihood * range_kernel(hit.t);
    if (GEOMETRY == 0u) return shade;
    shade += ray_geometry.distortion *
             distortion_by_weight(state.transmittance, hit.t - state.first_t, state.before, state.moment);
    return shade + dot(ray_geometry.normal, facing_normal(scene, ray, hit.instance, hit.surfel));
}

/// Blends the first n hits of the buffer front to back, and subtracts their share of the
/// loss from the remaining share.
void blend_chunk(TraceScene scene, Ray ray, RayGradient g, uint n, inout BlendState state) {
    for (uint i = 0u; i < n; ++i) {
        Hit hit = hit_at(i);
        float alpha = min(hit.alpha, scene.alpha_max);
        chunk_transmittance[i] = state.transmittance;
        chunk_w[i] = alpha * state.transmittance;
        chunk_shade[i] = shade_of(scene, ray, g, hit, state) - state.shift;
        add_compensated(state.remaining, state.lost, -chunk_w[i] * chunk_shade[i]);
        state.transmittance *= 1.0 - alpha;
        if (GEOMETRY != 0u) state.before += chunk_w[i] * (hit.t - state.first_t);
    }
}
#endif
