// SPDX-License-Identifier: Apache-2.0
// Assigns rays to threads and transforms a ray into the frame of a model.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_RAY_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_RAY_GLSL

struct Ray {
    vec3 origin;     // world, m
    vec3 direction;  // world, unit length
    float time_s;    // firing time relative to the sweep's reference time, or RELIDAR_NO_TIME
};

Ray ray_of(DeviceRay entry) { return Ray(entry.origin, entry.direction, entry.time_s); }

// The ray in the frame of the last entered instance. It is cached because consecutive
// candidates usually belong to one instance.
uint entered_instance = 0xffffffffu;
uint entered_first_surfel;
vec3 entered_origin;
vec3 entered_direction;
// rotation of the model since its reference time, in the model's axes; see turned_by()
vec3 entered_turn = vec3(0.0);

/// Returns the ray of this thread in the order of the batch, or at least n_rays if the
/// thread has none.
///
/// In an image, 8 consecutive threads are 4 x 2 pixels and 32 threads are 16 x 2 pixels.
/// Columns are closer together than rows, so these rays visit the same nodes. Tiles run
/// down the image first, then across. A driver such as lavapipe gives each of its threads
/// one contiguous range of workgroups. With this order each range has a similar share of
/// sky and ground, which differ in cost.
uint traced_ray(TraceScene scene) {
    uint i = thread_index();
    if (scene.columns == 0u) return i;
    uint tile = i >> 5u, down = (scene.n_rays / scene.columns + 1u) >> 1u;
    uint x = (tile / down) * 16u + ((i >> 1u) & 12u) + (i & 3u);
    uint y = (tile % down) * 2u + ((i >> 2u) & 1u);
    return x < scene.columns ? y * scene.columns + x : scene.n_rays;
}

vec3 model_point(InstanceEntry m, vec3 p) {
    return vec3(exact_dot(m.row0.xyz, p) + m.row0.w, exact_dot(m.row1.xyz, p) + m.row1.w,
                exact_dot(m.row2.xyz, p) + m.row2.w);
}
vec3 model_vector(InstanceEntry m, vec3 d) {
    return vec3(exact_dot(m.row0.xyz, d), exact_dot(m.row1.xyz, d), exact_dot(m.row2.xyz, d));
}

vec3 exact_cross(vec3 a, vec3 b) {
    precise vec3 product = vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
    return product;
}

/// Turns a vector by the rotation whose Rodrigues vector (axis times tangent of half the
/// angle) is g. It keeps lengths for every g, so that t is the same in the world and in a
/// model that turns.
vec3 turned_by(vec3 g, vec3 p) {
    vec3 q = exact_cross(g, p), r = exact_cross(g, q);
    precise vec3 result = p + 2.0 / (1.0 + exact_dot(g, g)) * (q + r);
    return result;
}

/// The Rodrigues vector of a rotation vector, by the series of the tangent: exact to
/// float for turns of up to half a radian.
vec3 rodrigues_vector(vec3 turn) {
    float x = 0.25 * exact_dot(turn, turn);
    precise vec3 g =
        0.5 * (1.0 + x * (1.0 / 3.0 + x * (2.0 / 15.0 + x * (17.0 / 315.0 + x * (62.0 / 2835.0))))) * turn;
    return g;
}

/// Moves the entered ray into the frame that a moving model has at the ray's firing time.
void follow_motion(TraceScene scene, uint instance, float time_s) {
    vec3 velocity = scene.instances.at[instance].velocity, turn_rate = scene.instances.at[instance].turn_rate;
    float span_s = scene.instances.at[instance].half_span_s;
    precise float since_s = clamp(time_s - scene.instances.at[instance].middle_s, -span_s, span_s);
    if (time_s == RELIDAR_NO_TIME) since_s = 0.0;
    precise vec3 origin = entered_origin - since_s * velocity;
    precise vec3 turn = since_s * turn_rate;
    entered_turn = rodrigues_vector(turn);
    entered_origin = turned_by(-entered_turn, origin);
    entered_direction = turned_by(-entered_turn, entered_direction);
}

/// Enters an instance: moves the ray into the frame of its model, at the pose that the
/// model has at the ray's firing time. All kernels and backends use this function.
void enter_instance(TraceScene scene, Ray ray, uint instance) {
    if (entered_instance == instance) return;
    InstanceEntry m = scene.instances.at[instance];
    entered_instance = instance;
    entered_first_surfel = m.first_surfel;
    entered_origin = model_point(m, ray.origin);
    entered_direction = model_vector(m, ray.direction);
    entered_turn = vec3(0.0);
    if (m.moves != 0u) follow_motion(scene, instance, ray.time_s);
}

/// Turns a vector of the entered instance's model into the world. Loads the instance at
/// this place, because rows that a caller loads early occupy 12 registers until they are
/// used.
vec3 world_vector(TraceScene scene, vec3 g) {
    InstanceEntry m = scene.instances.at[entered_instance];
    vec3 v = g;
    if (m.moves != 0u) v = turned_by(entered_turn, g);
    return m.row0.xyz * v.x + m.row1.xyz * v.y + m.row2.xyz * v.z;
}
#endif
