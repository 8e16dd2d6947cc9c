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
    float remaining;  // Part of the loss from the hits that are not blended yet and from the background.
    float lost;       // rounding error of `remaining`
};

/// Returns true if any blended value has a gradient.
bool has_gradient(RayGradient g) {
    bool any_gradient = false;
#define RELIDAR_HAS(name, built, value, input, slope, meaning) \
    any_gradient = any_gradient || (built && g.name != 0.0);
    RELIDAR_BLENDED_VALUES(RELIDAR_HAS)
#undef RELIDAR_HAS
    return any_gradient;
}

/// Returns the derivative of the loss with respect to the blending weight of a hit (g .
/// c).
float shade_of(TraceScene scene, Ray ray, RayGradient g, Hit hit) {
    vec3 channels = hit_channels(scene, ray, hit.instance, hit.surfel, scene.records.at[hit.surfel]);
    float shade = 0.0;
#define RELIDAR_SHADE(name, built, value, input, slope, meaning) \
    if (built) shade += g.name * (value);
    RELIDAR_BLENDED_VALUES(RELIDAR_SHADE)
#undef RELIDAR_SHADE
    return shade;
}

/// Blends the first n hits of the buffer from near to far. Subtracts their contribution
/// from the remaining loss.
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
