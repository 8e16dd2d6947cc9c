// SPDX-License-Identifier: Apache-2.0
// Implements the reference's surfel: activations, spherical harmonics with gradients,
// records, and the canonical intersection (docs/method.md section 2, M1 and M2). The
// formulas are kept simple, because speed does not matter here.
#include "surfel.hpp"

#include <glm/gtc/quaternion.hpp>

namespace relidar::reference {
namespace {

// Normalisation constants of the real spherical harmonics, from their definition. The 3D
// Gaussian Splatting code contains them as decimal numbers.
const double kC0 = std::sqrt(1.0 / (4.0 * kPi));
const double kC1 = std::sqrt(3.0 / (4.0 * kPi));
const double kC2xy = std::sqrt(15.0 / (4.0 * kPi));   // m = +-1 and -2
const double kC2zz = std::sqrt(5.0 / (16.0 * kPi));   // m = 0
const double kC2xx = std::sqrt(15.0 / (16.0 * kPi));  // m = 2
const double kC3a = std::sqrt(35.0 / (32.0 * kPi));   // m = +-3
const double kC3b = std::sqrt(105.0 / (4.0 * kPi));   // m = -2
const double kC3c = std::sqrt(21.0 / (32.0 * kPi));   // m = +-1
const double kC3d = std::sqrt(7.0 / (16.0 * kPi));    // m = 0
const double kC3e = std::sqrt(105.0 / (16.0 * kPi));  // m = 2

}  // namespace

glm::dmat3 rotation_matrix(const glm::dvec4& quaternion) {
    const glm::dvec4 q = quaternion / glm::length(quaternion);
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    return {glm::dvec3(1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),  // column a_u
            glm::dvec3(2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),  // column a_v
            // column normal
            glm::dvec3(2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))};
}

glm::dvec4 rotation_vjp(const glm::dvec4& quaternion, const glm::dmat3& d_rotation) {
    const double length = glm::length(quaternion);
    const glm::dvec4 q = quaternion / length;
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    const auto g = [&](int row, int column) { return d_rotation[column][row]; };
    const glm::dvec4 d_unit(2 * (z * (g(1, 0) - g(0, 1)) + y * (g(0, 2) - g(2, 0)) + x * (g(2, 1) - g(1, 2))),
                            2 * (y * (g(0, 1) + g(1, 0)) + z * (g(0, 2) + g(2, 0)) + w * (g(2, 1) - g(1, 2)) -
                                 2 * x * (g(1, 1) + g(2, 2))),
                            2 * (x * (g(0, 1) + g(1, 0)) + z * (g(1, 2) + g(2, 1)) + w * (g(0, 2) - g(2, 0)) -
                                 2 * y * (g(0, 0) + g(2, 2))),
                            2 * (x * (g(0, 2) + g(2, 0)) + y * (g(1, 2) + g(2, 1)) + w * (g(1, 0) - g(0, 1)) -
                                 2 * z * (g(0, 0) + g(1, 1))));
    return (d_unit - q * glm::dot(q, d_unit)) / length;
}

Activated activate(const Surfel& surfel) {
    Activated a{surfel.mean,
                rotation_matrix(surfel.rotation),
                glm::exp(surfel.log_scale),
                1.0 / (1.0 + std::exp(-surfel.opacity_logit)),
                {}};
    if (surfel.log_scale_w) a.scale_w = std::exp(*surfel.log_scale_w);
    return a;
}

std::array<double, kShCoefficients> sh_basis(const glm::dvec3& direction, int degree) {
    const double x = direction.x, y = direction.y, z = direction.z;
    std::array<double, kShCoefficients> b{};
    b[0] = kC0;
    if (degree < 1) return b;
    b[1] = -kC1 * y;
    b[2] = kC1 * z;
    b[3] = -kC1 * x;
    if (degree < 2) return b;
    b[4] = kC2xy * x * y;
    b[5] = -kC2xy * y * z;
    b[6] = kC2zz * (2 * z * z - x * x - y * y);
    b[7] = -kC2xy * x * z;
    b[8] = kC2xx * (x * x - y * y);
    if (degree < 3) return b;
    b[9] = -kC3a * y * (3 * x * x - y * y);
    b[10] = kC3b * x * y * z;
    b[11] = -kC3c * y * (4 * z * z - x * x - y * y);
    b[12] = kC3d * z * (2 * z * z - 3 * x * x - 3 * y * y);
    b[13] = -kC3c * x * (4 * z * z - x * x - y * y);
    b[14] = kC3e * z * (x * x - y * y);
    b[15] = -kC3a * x * (x * x - 3 * y * y);
    return b;
}

std::array<glm::dvec3, kShCoefficients> compute_sh_basis_gradient(const glm::dvec3& direction, int degree) {
    const double x = direction.x, y = direction.y, z = direction.z;
    std::array<glm::dvec3, kShCoefficients> g{};
    g.fill(glm::dvec3(0.0));
    if (degree < 1) return g;
    g[1] = -kC1 * glm::dvec3(0, 1, 0);
    g[2] = kC1 * glm::dvec3(0, 0, 1);
    g[3] = -kC1 * glm::dvec3(1, 0, 0);
    if (degree < 2) return g;
    g[4] = kC2xy * glm::dvec3(y, x, 0);
    g[5] = -kC2xy * glm::dvec3(0, z, y);
    g[6] = kC2zz * glm::dvec3(-2 * x, -2 * y, 4 * z);
    g[7] = -kC2xy * glm::dvec3(z, 0, x);
    g[8] = kC2xx * glm::dvec3(2 * x, -2 * y, 0);
    if (degree < 3) return g;
    g[9] = -kC3a * glm::dvec3(6 * x * y, 3 * x * x - 3 * y * y, 0);
    g[10] = kC3b * glm::dvec3(y * z, x * z, x * y);
    g[11] = -kC3c * glm::dvec3(-2 * x * y, 4 * z * z - x * x - 3 * y * y, 8 * y * z);
    g[12] = kC3d * glm::dvec3(-6 * x * z, -6 * y * z, 6 * z * z - 3 * x * x - 3 * y * y);
    g[13] = -kC3c * glm::dvec3(4 * z * z - 3 * x * x - y * y, -2 * x * y, 8 * x * z);
    g[14] = kC3e * glm::dvec3(2 * x * z, -2 * y * z, x * x - y * y);
    g[15] = -kC3a * glm::dvec3(3 * x * x - 3 * y * y, -6 * x * y, 0);
    return g;
}

glm::dvec3 evaluate_sh(const Surfel& surfel, const glm::dvec3& direction, int degree) {
    const auto basis = sh_basis(direction, degree);
    glm::dvec3 value(0.5);
    for (int channel = 0; channel < kShChannels; ++channel)
        for (int k = 0; k < kShCoefficients; ++k)
            value[channel] += basis[k] * surfel.sh[channel * kShCoefficients + k];
    return value;
}

Surfel move_to_phase(const Surfel& surfel, double turns) {
    const double angle = 2.0 * kPi * (turns - surfel.gait_phase);
    const double presence =
        std::exp(-surfel.gait_sharpness * surfel.gait_sharpness * (1.0 - std::cos(angle)));
    const double opacity = presence / (1.0 + std::exp(-surfel.opacity_logit));
    Surfel placed = surfel;
    placed.mean += std::sin(angle) * surfel.gait_swing;
    placed.opacity_logit = std::log(opacity / (1.0 - opacity));
    return placed;
}

DoubleRecord make_record(const Surfel& surfel) {
    const Activated a = activate(surfel);
    return {a.mean,
            a.opacity,
            a.rotation[0] / a.scale.x,
            a.rotation[1] / a.scale.y,
            a.rotation[2] / a.scale_w.value_or(1.0),
            a.scale_w ? PrimitiveType::gaussian : PrimitiveType::surfel};
}

FloatRecord make_float_record(const Surfel& surfel) {
    const DoubleRecord r = make_record(surfel);
    return {glm::vec3(r.mean),   float(r.sigma),      glm::vec3(r.axis_u),
            glm::vec3(r.axis_v), glm::vec3(r.normal), r.primitive};
}

LocalRay<double> to_model(const Pose& world_from_model, const Ray& ray) {
    const glm::dmat3 model_from_world = glm::transpose(glm::mat3_cast(world_from_model.rotation));
    return {model_from_world * (ray.origin - world_from_model.translation), model_from_world * ray.direction};
}

Pose pose_at(const Pose& world_from_model, const Motion& motion, double time_s) {
    const double since_s = motion.since(time_s), rate = glm::length(motion.angular_velocity);
    Pose pose = world_from_model;
    pose.translation += since_s * motion.velocity;
    if (rate > 0.0)
        pose.rotation = glm::angleAxis(since_s * rate, motion.angular_velocity / rate) * pose.rotation;
    return pose;
}

namespace {

/// Rotates `point` about g by the angle 2 atan |g|: point + 2 / (1 + g.g) (g x point + g
/// x (g x point)).
glm::vec3 turned(const glm::vec3& g, const glm::vec3& point) {
    const glm::vec3 q = glm::cross(g, point), r = glm::cross(g, q);
    return point + 2.0f / (1.0f + glm::dot(g, g)) * (q + r);
}

}  // namespace

LocalRay<float> follow(LocalRay<float> local, const Pose& world_from_model, const Motion& motion,
                       double time_s) {
    if (motion.is_none()) return local;
    const glm::dquat model_from_world = glm::conjugate(world_from_model.rotation);
    const glm::vec3 velocity(model_from_world * motion.velocity),
        angular_velocity(model_from_world * motion.angular_velocity);
    const float span_s = float(motion.half_span_s),
                since_s = std::clamp(float(time_s) - float(motion.middle_s), -span_s, span_s);
    const glm::vec3 rotation_vector = since_s * angular_velocity;
    const float half = 0.5f * glm::length(rotation_vector);
    const glm::vec3 g = (half > 0.0f ? std::tan(half) / half : 1.0f) * 0.5f * rotation_vector;
    return {turned(-g, local.origin - since_s * velocity), turned(-g, local.direction)};
}

FloatRows make_model_from_world_rows(const Pose& world_from_model) {
    // the columns of this matrix are the rows of its inverse
    const glm::dmat3 world_rotation = glm::mat3_cast(world_from_model.rotation);
    FloatRows rows{};
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) rows.row[i][j] = float(world_rotation[i][j]);
        rows.row[i][3] = float(-glm::dot(world_rotation[i], world_from_model.translation));
    }
    return rows;
}

LocalRay<float> to_model(const FloatRows& model_from_world, const glm::vec3& origin,
                         const glm::vec3& direction) {
    LocalRay<float> local{};
    for (int i = 0; i < 3; ++i) {
        const glm::vec3 axis(model_from_world.row[i][0], model_from_world.row[i][1],
                             model_from_world.row[i][2]);
        local.origin[i] = glm::dot(axis, origin) + model_from_world.row[i][3];
        local.direction[i] = glm::dot(axis, direction);
    }
    return local;
}

}  // namespace relidar::reference
