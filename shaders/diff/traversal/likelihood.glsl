// SPDX-License-Identifier: Apache-2.0
// Computes the likelihood of a hit given the measured range of its ray (docs/method.md
// M12). Only kernels that are built with likelihoods use this file. Include this file
// after includes.glsl.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_LIKELIHOOD_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_LIKELIHOOD_GLSL
RELIDAR_CONSTANT(uint, LIKELIHOOD, 0u);

// Measured range of this thread's ray in m, or 0 if no range is known.
float measured_range = 0.0;
float measured_per_scale = 0.0;  // inverse of the likelihood's scale, in 1/m

/// Loads the measured range of a ray into a variable of this thread.
void cache_range(TraceScene scene, uint ray_index) {
    measured_range = 0.0;
    if (is_null(scene.targets)) return;
    DeviceTarget target = scene.targets.at[scene.first_ray + ray_index * scene.ray_stride];
    if (target.weight > 0.0) measured_range = target.range_m;
    measured_per_scale = 1.0 / scene.likelihood_scale_m;
}

/// Returns the likelihood of the measured range z if the surface is at distance t:
/// 1 / (1 + ((t - z) / s)^2), with the noise scale s. Returns 0 without a measurement.
/// @param surface_t distance t of the surface along the ray, m
float range_likelihood(float surface_t) {
    if (!(measured_range > 0.0)) return 0.0;
    float d = (surface_t - measured_range) * measured_per_scale;
    return 1.0 / (1.0 + d * d);
}

/// Returns the derivative of range_likelihood() with respect to `surface_t`.
float range_likelihood_vjp(float surface_t) {
    float k = range_likelihood(surface_t);
    return -2.0 * (surface_t - measured_range) * measured_per_scale * measured_per_scale * k * k;
}
#endif
