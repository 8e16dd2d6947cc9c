// SPDX-License-Identifier: Apache-2.0
// Groups the hits of a ray into surfaces (docs/method.md M13). A new surface begins if
// the distance to the previous hit exceeds a threshold. The hits are sorted by distance,
// so one pass is enough to find the surface with the largest weight. Also computes the
// normals at hits. Include this file after includes.glsl.
#ifndef RELIDAR_INCLUDED_DIFF_FORWARD_SURFACES_GLSL
#define RELIDAR_INCLUDED_DIFF_FORWARD_SURFACES_GLSL
RELIDAR_CONSTANT(uint, NORMAL, 0u);

/// Returns the unit normal of a surfel in the world frame, with the sign that makes it
/// face the sensor.
vec3 facing_normal(TraceScene scene, Ray ray, uint instance, uint surfel) {
    enter_instance(scene, ray, instance);
    vec3 normal = scene.records.at[surfel].normal;
    float side = exact_dot(normal, entered_direction) > 0.0 ? -1.0 : 1.0;
    return side * rotate_to_world(scene, normal);
}

RELIDAR_CONSTANT(uint, MODE, 0u);

struct Surfaces {
    float last_t;      // t of the previous hit
    float start;       // t of the first hit of the current surface
    float weight;      // sum of the blending weights of the current surface
    float moment;      // sum w (t - start) over the current surface
    float heaviest;    // largest weight of a surface so far
    float heaviest_t;  // mean of t over the surface with the largest weight
};

Surfaces empty_surfaces() { return Surfaces(-1e30, 0.0, 0.0, 0.0, 0.0, 0.0); }

/// Keeps the current surface as the result if it has a larger weight than all surfaces
/// before. With equal weights, the nearer surface is kept.
void keep_heaviest(inout Surfaces surfaces) {
    if (!(surfaces.weight > surfaces.heaviest)) return;
    surfaces.heaviest = surfaces.weight;
    surfaces.heaviest_t = surfaces.start + surfaces.moment / surfaces.weight;
}

/// Adds a hit to the current surface. Starts a new surface if the gap to the previous hit
/// is larger than `max_gap_m`.
void add_to_surfaces(float hit_t, float hit_weight, float max_gap_m, inout Surfaces surfaces) {
    if (hit_t - surfaces.last_t > max_gap_m) {
        keep_heaviest(surfaces);
        surfaces.start = hit_t;
        surfaces.weight = surfaces.moment = 0.0;
    }
    surfaces.last_t = hit_t;
    surfaces.weight += hit_weight;
    surfaces.moment += hit_weight * (hit_t - surfaces.start);
}
#endif
