// SPDX-License-Identifier: Apache-2.0
// How well a hit explains the range that its ray measured (docs/method.md M12), for the
// kernels that are built for it. Include after includes.glsl.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_LIKELIHOOD_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_LIKELIHOOD_GLSL
RELIDAR_CONSTANT(uint, LIKELIHOOD, 0u);

// Of the ray of this thread, where LIKELIHOOD.
float measured_range = 0.0;      // m; 0: none, dropped or unknown
float measured_per_scale = 0.0;  // 1/m

/// Makes them those of a ray of the batch.
void take_measured(TraceScene scene, uint ray) {
    measured_range = 0.0;
    if (is_null(scene.targets)) return;
    DeviceTarget target = scene.targets.at[scene.first_ray + ray * scene.ray_stride];
    if (target.weight > 0.0) measured_range = target.range_m;
    measured_per_scale = 1.0 / scene.likelihood_scale_m;
}

/// k = 1 / (1 + ((t - z) / s)^2)
float range_kernel(float t) {
    if (!(measured_range > 0.0)) return 0.0;
    float d = (t - measured_range) * measured_per_scale;
    return 1.0 / (1.0 + d * d);
}

/// dk/dt = -2 (t - z) / s^2 k^2
float range_kernel_by_t(float t) {
    float k = range_kernel(t);
    return -2.0 * (t - measured_range) * measured_per_scale * measured_per_scale * k * k;
}
#endif
