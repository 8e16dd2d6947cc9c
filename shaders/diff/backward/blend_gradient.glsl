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
};

/// g . c of a hit: what a unit of its weight is worth to the loss.
float shade_of(TraceScene scene, Ray ray, RayGradient g, Hit hit) {
    vec3 channels = hit_channels(scene, ray, hit.instance, hit.surfel, scene.records.at[hit.surfel]);
    float shade = 0.0;
#define RELIDAR_SHADE(name, built, value, input, slope, meaning) \
    if (built) shade += g.name * (value);
    RELIDAR_BLENDED_VALUES(RELIDAR_SHADE)
#undef RELIDAR_SHADE
    return shade;
}

/// Blends the hits in the buffer front to back, n of them, and takes their share of the
/// loss from what remains.
void blend_chunk(TraceScene scene, Ray ray, RayGradient g, uint n, inout BlendState state) {
    for (uint i = 0u; i < n; ++i) {
        Hit hit = hit_at(i);
        float alpha = min(hit.alpha, scene.alpha_max);
        chunk_transmittance[i] = state.transmittance;
        chunk_w[i] = alpha * state.transmittance;
        chunk_shade[i] = shade_of(scene, ray, g, hit) - state.shift;
        add_compensated(state.remaining, state.lost, -chunk_w[i] * chunk_shade[i]);
        state.transmittance *= 1.0 - alpha;
    }
}
#endif
