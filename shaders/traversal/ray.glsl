// SPDX-License-Identifier: Apache-2.0
// Which ray a thread traces, and the ray in the frame of a model.
#ifndef RELIDAR_INCLUDED_TRAVERSAL_RAY_GLSL
#define RELIDAR_INCLUDED_TRAVERSAL_RAY_GLSL

struct Ray {
    vec3 origin;      // world, m
    vec3 direction;   // world, unit
};

// The ray in the frame of the model that was met last: candidates come in runs of one instance.
uint entered_instance = 0xffffffffu;
uint entered_first_surfel;
vec3 entered_origin;
vec3 entered_direction;

/// The ray of this thread, in the order of the batch; n_rays and more: none. In an image, 8 threads in sequence are 4 x 2 neighbours, and
/// 32 are 16 x 2, for columns lie closer than rows: they open the same nodes. Tiles run down the image, then across: a driver that gives
/// each of its threads one stretch of the workgroups (lavapipe) so gives each a like share of sky and ground, which cost differently.
uint traced_ray(TraceScene scene) {
    uint i = thread_index();
    if (scene.columns == 0u) return i;
    uint tile = i >> 5u, down = (scene.n_rays / scene.columns + 1u) >> 1u;
    uint x = (tile / down) * 16u + ((i >> 1u) & 12u) + (i & 3u);
    uint y = (tile % down) * 2u + ((i >> 2u) & 1u);
    return x < scene.columns ? y * scene.columns + x : scene.n_rays;
}

vec3 model_point(InstanceEntry m, vec3 p) {
    return vec3(exact_dot(m.row0.xyz, p) + m.row0.w, exact_dot(m.row1.xyz, p) + m.row1.w, exact_dot(m.row2.xyz, p) + m.row2.w);
}
vec3 model_vector(InstanceEntry m, vec3 d) {
    return vec3(exact_dot(m.row0.xyz, d), exact_dot(m.row1.xyz, d), exact_dot(m.row2.xyz, d));
}
vec3 world_vector(InstanceEntry m, vec3 g) { return m.row0.xyz * g.x + m.row1.xyz * g.y + m.row2.xyz * g.z; }

void enter_instance(TraceScene scene, Ray ray, uint instance) {
    if (entered_instance == instance) return;
    InstanceEntry m = scene.instances.at[instance];
    entered_instance = instance;
    entered_first_surfel = m.first_surfel;
    entered_origin = model_point(m, ray.origin);
    entered_direction = model_vector(m, ray.direction);
}
#endif
