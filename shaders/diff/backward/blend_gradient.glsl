// SPDX-License-Identifier: Apache-2.0
// Repeats the blending of the forward pass to compute how each hit contributes to the
// loss (docs/method.md M7). Processes the hits in chunks and stores the blended values of
// one chunk. The sum over all hits behind a hit is then computed back to front. A
// difference of two long sums would lose precision where 1 / (1 - alpha) is large.
#ifndef RELIDAR_INCLUDED_DIFF_BACKWARD_BLEND_GRADIENT_GLSL
#define RELIDAR_INCLUDED_DIFF_BACKWARD_BLEND_GRADIENT_GLSL
float chunk_transmittance[SLOTS];
float chunk_w[SLOTS];
float chunk_shade[SLOTS];

struct BlendState {
    float shift;
    float transmittance;
    float remaining;  // Part of the loss from the background and from the hits that are not blended yet.
    float lost;       // rounding error of `remaining`
};

/// Returns true if any value that the ray blends from its hits has a non-zero gradient.
bool has_gradient(RayGradient gradient) {
    bool any_gradient = false;
#define RELIDAR_HAS(name, built, value, input, slope, meaning) \
    any_gradient = any_gradient || (built && gradient.name != 0.0);
    RELIDAR_BLENDED_VALUES(RELIDAR_HAS)
#undef RELIDAR_HAS
    return any_gradient;
}

/// Returns the derivative of the loss with respect to the blending weight of a hit. Each
/// blended value (depth, intensity, ...) contributes its gradient times the hit's value.
float weight_gradient(TraceScene scene, Ray ray, RayGradient gradient, Hit hit) {
    vec3 channels = shade_hit(scene, ray, hit.instance, hit.surfel, scene.records.at[hit.surfel]);
    float shade = 0.0;
#define RELIDAR_SHADE(name, built, value, input, slope, meaning) \
    if (built) shade += gradient.name * (value);
    RELIDAR_BLENDED_VALUES(RELIDAR_SHADE)
#undef RELIDAR_SHADE
    return shade;
}

/// Blends the nearest `hit_count` hits in the buffer. Stores transmittance, weight and
/// gradient of each hit, and updates `state`.
void blend_hit_chunk(TraceScene scene, Ray ray, RayGradient gradient, uint hit_count,
                     inout BlendState state) {
    for (uint i = 0u; i < hit_count; ++i) {
        Hit hit = load_hit(i);
        float alpha = min(hit.alpha, scene.alpha_max);
        chunk_transmittance[i] = state.transmittance;
        chunk_w[i] = alpha * state.transmittance;
        chunk_shade[i] = weight_gradient(scene, ray, gradient, hit) - state.shift;
        kahan_add(state.remaining, state.lost, -chunk_w[i] * chunk_shade[i]);
        state.transmittance *= 1.0 - alpha;
    }
}
#endif
