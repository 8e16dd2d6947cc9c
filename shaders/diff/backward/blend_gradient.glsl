// SPDX-License-Identifier: Apache-2.0
// The blending of the forward pass once more, chunk by chunk, for the share that each hit
// has in the loss (M7). One chunk is kept as it was blended, so that what lies behind a
// hit is summed back to front instead of by subtracting two long sums: no digits are lost
// where 1 / (1 - alpha) is large.
#ifndef RELIDAR_INCLUDED_DIFF_BACKWARD_BLEND_GRADIENT_GLSL
#define RELIDAR_INCLUDED_DIFF_BACKWARD_BLEND_GRADIENT_GLSL
float chunk_transmittance[SLOTS];
float chunk_w[SLOTS];
float chunk_shade[SLOTS];

/// What is carried from chunk to chunk.
struct BlendState {
    float shift;
    float transmittance;
    float remaining;  // share of the loss of everything not blended yet, background included
    float lost;       // what rounding took from it
    float first_t;    // of the ray's first hit (geometry alone, as what follows)
    float before;     // sum of w (t - first_t) over the hits blended
    float moment;     // and over all of the ray
};

/// g . c of a hit: what a unit of its weight is worth to the loss.
float shade_of(TraceScene scene, Ray ray, RayGradient g, Hit hit, BlendState state) {
    vec3 c = hit_channels(scene, ray, hit.instance, hit.surfel, scene.records.at[hit.surfel]);
    float shade = g.depth * hit.t + g.weight + g.intensity * c.x + g.hit_logit * c.y + g.drop_logit * c.z;
    if (LIKELIHOOD != 0u) shade += ray_geometry.likelihood * range_kernel(hit.t);
    if (GEOMETRY == 0u) return shade;
    shade += ray_geometry.distortion *
             distortion_by_weight(state.transmittance, hit.t - state.first_t, state.before, state.moment);
    return shade + dot(ray_geometry.normal, facing_normal(scene, ray, hit.instance, hit.surfel));
}

/// Blends the hits in the buffer front to back, n of them, and takes their share of the
/// loss from what remains.
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
