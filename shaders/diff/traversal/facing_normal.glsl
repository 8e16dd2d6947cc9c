// SPDX-License-Identifier: Apache-2.0
// Normals of hits, for the kernels that are built for the geometric losses
// (docs/method.md section 3, M11). Include after includes.glsl.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_FACING_NORMAL_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_FACING_NORMAL_GLSL
RELIDAR_CONSTANT(uint, GEOMETRY, 0u);

/// @return -1 where a surfel's normal points along the ray, 1 where it faces the sensor;
/// a constant as far as gradients go
/// @param direction  of the ray, in the model's frame as the normal
float facing_side(vec3 normal, vec3 direction) { return exact_dot(normal, direction) > 0.0 ? -1.0 : 1.0; }

/// Unit normal of a surfel on the side that faces the sensor, world.
vec3 facing_normal(TraceScene scene, Ray ray, uint instance, uint surfel) {
    enter_instance(scene, ray, instance);
    vec3 normal = scene.records.at[surfel].normal;
    return facing_side(normal, entered_direction) * world_vector(scene, normal);
}
#endif
