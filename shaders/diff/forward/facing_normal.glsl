// SPDX-License-Identifier: Apache-2.0
// Computes surface normals at hits. Only kernels that blend normals use this file.
// Include it after includes.glsl.
#ifndef RELIDAR_INCLUDED_DIFF_FORWARD_FACING_NORMAL_GLSL
#define RELIDAR_INCLUDED_DIFF_FORWARD_FACING_NORMAL_GLSL
RELIDAR_CONSTANT(uint, NORMAL, 0u);

/// Returns the unit normal of a surfel in the world frame, with the sign that makes it
/// face the sensor.
vec3 facing_normal(TraceScene scene, Ray ray, uint instance, uint surfel) {
    enter_instance(scene, ray, instance);
    vec3 normal = scene.records.at[surfel].normal;
    float side = exact_dot(normal, entered_direction) > 0.0 ? -1.0 : 1.0;
    return side * rotate_to_world(scene, normal);
}
#endif
