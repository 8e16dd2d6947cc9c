// SPDX-License-Identifier: Apache-2.0
// Implements a surfel in double precision from docs/method.md: activations (section 2),
// real spherical harmonics of degree 3, intersection (M1) and opacity (M2), or those of a
// 3D Gaussian (M9). Must not include shaders/ or src/. `intersect_in_float` is the same
// formula in single precision, in the form of the shader, so that hit ids can be compared
// exactly.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include <glm/glm.hpp>

#include <relidar/base/math.hpp>
#include <relidar/scene/scene.hpp>

namespace relidar::reference {

/// Parameters of a surfel in the model's frame: the same 58 numbers as a row of
/// relidar::Surfels. Also used for their gradient.
struct Surfel {
    glm::dvec3 mean{0.0};  ///< position of the centre in metres
    /// quaternion w, x, y, z, unnormalised
    glm::dvec4 rotation{1.0, 0.0, 0.0, 0.0};
    glm::dvec2 log_scale{0.0};  ///< logarithm of the scales in metres
    /// Logarithm of the scale along the normal (scale in metres). Only a 3D Gaussian has
    /// this scale.
    std::optional<double> log_scale_w;
    double opacity_logit = 0.0;
    double gait_phase = 0.0;  ///< phase of the gait, in turns
    double gait_sharpness = 0.0;
    glm::dvec3 gait_swing{0.0};          ///< swing of the gait, in metres
    std::array<double, kShFloats> sh{};  ///< [3,16] channel-major: intensity, hit logit, drop logit
};

/// Parameters after activation: mean, R (columns a_u, a_v, normal), scales (s_u, s_v) in
/// metres, opacity sigma, and s_w for a 3D Gaussian.
struct Activated {
    glm::dvec3 mean;
    glm::dmat3 rotation;
    glm::dvec2 scale;
    double opacity;
    std::optional<double> scale_w;
};
Activated activate(const Surfel& surfel);

/// Returns R of the normalised quaternion (w, x, y, z). The result is not finite for a
/// zero quaternion.
glm::dmat3 rotation_matrix(const glm::dvec4& quaternion);
/// Returns dL/d(quaternion) from dL/dR (same layout as R: [column][row]). The result is
/// perpendicular to the quaternion.
glm::dvec4 rotation_vjp(const glm::dvec4& quaternion, const glm::dmat3& d_rotation);

/// Returns the real SH basis of 3D Gaussian Splatting: order l, m = -l..l, with the
/// Condon-Shortley sign (-1)^m. The values are homogeneous polynomials of the direction,
/// which is not renormalised. Entries above `degree` are 0.
std::array<double, kShCoefficients> sh_basis(const glm::dvec3& direction, int degree);
/// Returns d basis / d direction of the same polynomials.
std::array<glm::dvec3, kShCoefficients> compute_sh_basis_gradient(const glm::dvec3& direction, int degree);

/// Returns the three channels 0.5 + basis . coefficients, before the intensity is
/// clamped.
glm::dvec3 evaluate_sh(const Surfel& surfel, const glm::dvec3& direction, int degree);

template <typename Real>
struct Record {
    glm::vec<3, Real> mean;
    Real sigma;
    glm::vec<3, Real> axis_u;  ///< a_u / s_u
    glm::vec<3, Real> axis_v;  ///< a_v / s_v
    glm::vec<3, Real> normal;  ///< a_w / s_w for a 3D Gaussian
    PrimitiveType primitive = PrimitiveType::surfel;
};
using FloatRecord = Record<float>;
using DoubleRecord = Record<double>;

/// Computes the intersection record of a surfel in double. The float record is rounded
/// from this record.
DoubleRecord make_record(const Surfel& surfel);
/// Returns the surfel at a phase of its gait (M14), with the moved mean and the reduced
/// opacity.
Surfel move_to_phase(const Surfel& surfel, double turns);
FloatRecord make_float_record(const Surfel& surfel);

/// Ray in a model's frame. Its direction has the same length as in the world frame, so
/// that t is the same in both frames.
template <typename Real>
struct LocalRay {
    glm::vec<3, Real> origin;
    glm::vec<3, Real> direction;
};

/// Ray in the world frame. The direction is a free vector that is never renormalised.
struct Ray {
    glm::dvec3 origin{0.0};
    glm::dvec3 direction{1.0, 0.0, 0.0};
    double measured_m = 0.0;  ///< measured range; 0 without a return
    double time_s = 0.0;      ///< firing time, relative to the reference time of the sweep
};
LocalRay<double> to_model(const Pose& world_from_model, const Ray& ray);

/// Motion of a model during a sweep. At time t, the pose is world_from_model, translated
/// by `velocity` and rotated by `angular_velocity` for clamp(t - middle_s, -half_span_s,
/// half_span_s) seconds. The rotation vector is expressed in the world's axes and turns
/// the model about its origin.
struct Motion {
    glm::dvec3 velocity{0.0};          ///< m/s, world
    glm::dvec3 angular_velocity{0.0};  ///< rad/s
    double middle_s = 0.0;
    double half_span_s = 0.0;

    double since(double time_s) const { return std::clamp(time_s - middle_s, -half_span_s, half_span_s); }
    bool is_none() const {
        return !(half_span_s > 0.0) || (velocity == glm::dvec3(0.0) && angular_velocity == glm::dvec3(0.0));
    }
};
/// Returns the pose of a moving model at a time.
Pose pose_at(const Pose& world_from_model, const Motion& motion, double time_s);
/// Transforms a ray in the model's frame according to the motion of the model, in float
/// like a kernel.
LocalRay<float> follow(LocalRay<float> local, const Pose& world_from_model, const Motion& motion,
                       double time_s);

/// Rows of the 3x4 matrix model_from_world, computed in double and rounded to float.
struct FloatRows {
    float row[3][4];
};
FloatRows make_model_from_world_rows(const Pose& world_from_model);
LocalRay<float> to_model(const FloatRows& model_from_world, const glm::vec3& origin,
                         const glm::vec3& direction);

template <typename Real>
struct PlaneHit {
    Real t;
    /// Distance from the mean in standard deviations, along a_u and a_v. For a 3D
    /// Gaussian, also along a_w.
    Real u, v, w;
    Real alpha;  ///< sigma * G, before the clamp to alpha_max
};

/// Intersects a ray with the plane of a surfel (M1, M2).
/// @return t is not finite if the ray is parallel to the plane
template <typename Real>
PlaneHit<Real> intersect_plane_of_surfel(const Record<Real>& record, const LocalRay<Real>& ray) {
    const glm::vec<3, Real> to_mean = record.mean - ray.origin;
    const Real t = glm::dot(record.normal, to_mean) / glm::dot(record.normal, ray.direction);
    const glm::vec<3, Real> p = t * ray.direction - to_mean;
    const Real u = glm::dot(record.axis_u, p);
    const Real v = glm::dot(record.axis_v, p);
    return {t, u, v, Real(0), record.sigma * std::exp(Real(-0.5) * (u * u + v * v))};
}

/// Returns the point of largest density along the ray (M9), with a correction for
/// rounding errors.
template <typename Real>
PlaneHit<Real> intersect_gaussian_shape(const Record<Real>& record, const LocalRay<Real>& ray) {
    using Vector = glm::vec<3, Real>;
    const auto whitened = [&](const Vector& x) {
        return Vector(glm::dot(record.axis_u, x), glm::dot(record.axis_v, x), glm::dot(record.normal, x));
    };
    const Vector to_mean = record.mean - ray.origin, b = whitened(ray.direction);
    const Real length2 = glm::dot(b, b), t = glm::dot(whitened(to_mean), b) / length2;
    const Vector q = whitened(t * ray.direction - to_mean);
    const Real forgiven = Real(5e-5), off = glm::dot(q, b) / length2;
    const Vector r = q - std::min(std::max(off, -forgiven), forgiven) * b;
    return {t, r.x, r.y, r.z, record.sigma * std::exp(Real(-0.5) * glm::dot(r, r))};
}

/// Returns position and strength of the intersection of a ray with a primitive, before
/// the opacity and range limits are applied.
template <typename Real>
PlaneHit<Real> meet(const Record<Real>& record, const LocalRay<Real>& ray) {
    return record.primitive == PrimitiveType::gaussian ? intersect_gaussian_shape(record, ray)
                                                       : intersect_plane_of_surfel(record, ray);
}

/// Intersects a ray with a surfel (M1 and M2, or M9). Returns std::nullopt if the ray
/// misses the surfel. All traversals use this formula. The ray hits if t is finite (the
/// ray is not parallel to the plane), t > near, sigma * exp(-r2 / 2) >= alpha_min, the
/// record is finite, and sigma > alpha_min.
template <typename Real>
std::optional<PlaneHit<Real>> intersect(const Record<Real>& record, const LocalRay<Real>& ray,
                                        const ImageModel& model) {
    const PlaneHit<Real> hit = meet(record, ray);
    if (!std::isfinite(hit.t) || !(hit.t > Real(model.near_m))) return std::nullopt;
    if (!(hit.alpha >= Real(model.alpha_min))) return std::nullopt;  // also true if alpha is NaN
    const auto finite = [](const glm::vec<3, Real>& x) {
        return std::isfinite(x.x) && std::isfinite(x.y) && std::isfinite(x.z);
    };
    if (!finite(record.mean) || !finite(record.axis_u) || !finite(record.axis_v) || !finite(record.normal))
        return std::nullopt;
    if (!std::isfinite(record.sigma) || !(record.sigma > Real(model.alpha_min))) return std::nullopt;
    return hit;
}

}  // namespace relidar::reference
