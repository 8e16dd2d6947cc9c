// SPDX-License-Identifier: Apache-2.0
// Assigns rays to threads, and transforms rays into the frame of a model.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_RAY_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_RAY_GLSL

struct Ray {
    vec3 origin;     // world, m
    vec3 direction;  // world, unit length
    float time_s;    // Firing time relative to the reference time of the sweep, or RELIDAR_NO_TIME.
};

Ray make_ray(DeviceRay entry) { return Ray(entry.origin, entry.direction, entry.time_s); }

// enter_instance() transforms this thread's ray into the model frame of an instance and
// stores it in the variables below. This is the index of that instance.
uint entered_instance = 0xffffffffu;
uint entered_first_surfel;
vec3 entered_origin;
vec3 entered_direction;
// Rotation of a moving instance from its stored pose (InstanceEntry) until the ray is
// fired. Rodrigues vector in the model frame: axis times tangent of half the angle.
vec3 entered_turn = vec3(0.0);

/// Returns the index of this thread's ray in the batch, at least n_rays if it has no ray.
/// In an image, 8 consecutive threads trace 4 x 2 pixels, and 32 threads 16 x 2 pixels,
/// because these rays visit the same tree nodes. Tiles are numbered down the image first,
/// then across, so that the contiguous ranges of workgroups that lavapipe gives to its
/// threads contain sky and ground in similar shares.
uint traced_ray(TraceScene scene) {
    uint i = thread_index();
    if (scene.columns == 0u) return i;
    uint tile = i >> 5u, down = (scene.n_rays / scene.columns + 1u) >> 1u;
    uint x = (tile / down) * 16u + ((i >> 1u) & 12u) + (i & 3u);
    uint y = (tile % down) * 2u + ((i >> 2u) & 1u);
    return x < scene.columns ? y * scene.columns + x : scene.n_rays;
}

vec3 to_model_point(InstanceEntry instance, vec3 point) {
    return vec3(exact_dot(instance.row0.xyz, point) + instance.row0.w,
                exact_dot(instance.row1.xyz, point) + instance.row1.w,
                exact_dot(instance.row2.xyz, point) + instance.row2.w);
}
vec3 to_model_vector(InstanceEntry instance, vec3 direction) {
    return vec3(exact_dot(instance.row0.xyz, direction), exact_dot(instance.row1.xyz, direction),
                exact_dot(instance.row2.xyz, direction));
}

vec3 exact_cross(vec3 a, vec3 b) {
    precise vec3 product = vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
    return product;
}

/// Rotates a vector by a Rodrigues vector (axis times tangent of half the angle). This
/// preserves the vector's length exactly. Therefore distances t along a ray are the same
/// in the world and in a rotated model.
vec3 rodrigues_rotate(vec3 rotation, vec3 point) {
    vec3 q = exact_cross(rotation, point), r = exact_cross(rotation, q);
    precise vec3 result = point + 2.0 / (1.0 + exact_dot(rotation, rotation)) * (q + r);
    return result;
}

/// Converts a rotation vector (axis times angle) to a Rodrigues vector (axis times
/// tangent of half the angle). Exact to float precision for angles of up to half a
/// radian.
vec3 to_rodrigues(vec3 rotation_vector) {
    float x = 0.25 * exact_dot(rotation_vector, rotation_vector);
    precise vec3 g = 0.5 *
                     (1.0 + x * (1.0 / 3.0 + x * (2.0 / 15.0 + x * (17.0 / 315.0 + x * (62.0 / 2835.0))))) *
                     rotation_vector;
    return g;
}

/// Corrects the cached ray for the motion of its model. Afterwards, the ray is relative
/// to the model's pose at the time `time_s`.
void move_ray(TraceScene scene, uint instance, float time_s) {
    vec3 velocity = scene.instances.at[instance].velocity, turn_rate = scene.instances.at[instance].turn_rate;
    float span_s = scene.instances.at[instance].half_span_s;
    precise float since_s = clamp(time_s - scene.instances.at[instance].middle_s, -span_s, span_s);
    if (time_s == RELIDAR_NO_TIME) since_s = 0.0;
    precise vec3 origin = entered_origin - since_s * velocity;
    precise vec3 turn = since_s * turn_rate;
    entered_turn = to_rodrigues(turn);
    entered_origin = rodrigues_rotate(-entered_turn, origin);
    entered_direction = rodrigues_rotate(-entered_turn, entered_direction);
}

/// Transforms the ray into the frame of an instance's model at the ray's firing time. All
/// kernels and traversal methods call this function, so that they get bit-identical rays.
void enter_instance(TraceScene scene, Ray ray, uint instance) {
    if (entered_instance == instance) return;
    InstanceEntry m = scene.instances.at[instance];
    entered_instance = instance;
    entered_first_surfel = m.first_surfel;
    entered_origin = to_model_point(m, ray.origin);
    entered_direction = to_model_vector(m, ray.direction);
    entered_turn = vec3(0.0);
    if (m.moves != 0u) move_ray(scene, instance, ray.time_s);
}

/// Rotates a vector from the frame of the current model into the world frame. Loads the
/// instance again. If it stayed loaded, it would occupy 12 registers during the search.
vec3 rotate_to_world(TraceScene scene, vec3 model_vector) {
    InstanceEntry m = scene.instances.at[entered_instance];
    vec3 v = model_vector;
    if (m.moves != 0u) v = rodrigues_rotate(entered_turn, model_vector);
    return m.row0.xyz * v.x + m.row1.xyz * v.y + m.row2.xyz * v.z;
}
#endif
