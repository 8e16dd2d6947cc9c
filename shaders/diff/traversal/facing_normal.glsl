// SPDX-License-Identifier: Apache-2.0
// Normals of hits, for kernels that are built with the geometric losses (docs/method.md
// section 5). Include this file after includes.glsl.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_FACING_NORMAL_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_FACING_NORMAL_GLSL
RELIDAR_CONSTANT(uint, GEOMETRY, 0u);

/// Returns -1 if a surfel's normal points along the ray, or 1 if the normal faces the
/// sensor. Gradients treat the result as a constant.
/// @param direction  direction of the ray, in the model's frame like the normal
float facing_side(vec3 normal, vec3 direction) { return exact_dot(normal, direction) > 0.0 ? -1.0 : 1.0; }

/// Returns the unit normal of a surfel on the side that faces the sensor, in the world
/// frame.
vec3 facing_normal(TraceScene scene, Ray ray, uint instance, uint surfel) {
    enter_instance(scene, ray, instance);
    vec3 normal = scene.records.at[surfel].normal;
    return facing_side(normal, entered_direction) * world_vector(scene, normal);
}
#endif
