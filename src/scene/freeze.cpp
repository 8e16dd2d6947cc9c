// SPDX-License-Identifier: Apache-2.0
// Converts a scene at one time into a single set of surfels in the world frame.
#include <relidar/scene/scene.hpp>

#include <cmath>

#include "base/fail.hpp"
#include "base/parallel.hpp"

namespace relidar {
namespace {

using ShBasis = std::array<double, kShCoefficients>;

/// Evaluates the real spherical harmonics up to degree 3, which are orthonormal on the
/// sphere. Computes the same values as shaders/scene/gaussian/sh.glsl, in double
/// precision.
/// @param direction unit vector
ShBasis evaluate_sh(const glm::dvec3& direction) {
    const double x = direction.x, y = direction.y, z = direction.z, xx = x * x, yy = y * y, zz = z * z;
    const auto root = [](double part) { return std::sqrt(part / kPi); };
    return {root(0.25),
            -root(0.75) * y,
            root(0.75) * z,
            -root(0.75) * x,
            root(3.75) * x * y,
            -root(3.75) * y * z,
            root(0.3125) * (2.0 * zz - xx - yy),
            -root(3.75) * x * z,
            root(0.9375) * (xx - yy),
            -root(1.09375) * y * (3.0 * xx - yy),
            root(26.25) * x * y * z,
            -root(0.65625) * y * (4.0 * zz - xx - yy),
            root(0.4375) * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
            -root(0.65625) * x * (4.0 * zz - xx - yy),
            root(6.5625) * z * (xx - yy),
            -root(1.09375) * x * (xx - 3.0 * yy)};
}

using ShRotation = std::array<std::array<double, kShCoefficients>, kShCoefficients>;

/// Returns the matrix that rotates coefficients of spherical harmonics (SH, Y_i) from the
/// model frame to the world frame with R, the rotation of `world_from_model`. Element
/// (i, j) is the integral of Y_i(R d) Y_j(d) over all directions d. A weighted sum over
/// four heights z (Gauss-Legendre) with eight azimuths each is exact, because each Y has
/// at most degree 3, so that a product has at most degree 6.
ShRotation make_sh_rotation(const glm::dquat& world_from_model) {
    // height z and weight
    constexpr std::array<std::array<double, 2>, 4> kGaussNodes{{{-0.8611363115940526, 0.3478548451374538},
                                                                {-0.3399810435848563, 0.6521451548625461},
                                                                {0.3399810435848563, 0.6521451548625461},
                                                                {0.8611363115940526, 0.3478548451374538}}};
    constexpr int kAzimuths = 8;
    ShRotation rotation{};
    for (const auto& [z, weight] : kGaussNodes)
        for (int k = 0; k < kAzimuths; ++k) {
            const double azimuth = 2.0 * kPi * k / kAzimuths, radius = std::sqrt(1.0 - z * z);
            const glm::dvec3 direction(radius * std::cos(azimuth), radius * std::sin(azimuth), z);
            const ShBasis in_model = evaluate_sh(direction),
                          in_world = evaluate_sh(world_from_model * direction);
            for (std::size_t i = 0; i < kShCoefficients; ++i)
                for (std::size_t j = 0; j < kShCoefficients; ++j)
                    rotation[i][j] += weight * 2.0 * kPi / kAzimuths * in_world[i] * in_model[j];
        }
    return rotation;
}

void rotate_sh(const ShRotation& rotation, float* coefficients) {
    std::array<float, kShCoefficients> rotated;
    for (std::size_t i = 0; i < kShCoefficients; ++i) {
        double sum = 0.0;
        for (std::size_t j = 0; j < kShCoefficients; ++j) sum += rotation[i][j] * double(coefficients[j]);
        rotated[i] = float(sum);
    }
    std::ranges::copy(rotated, coefficients);
}

/// Moves a surfel of a walking actor to its position at a phase of the walk. Reduces its
/// opacity the more, the farther this phase is from that of the surfel:
///   mean += swing sin(angle),  opacity *= exp(sharpness^2 (cos(angle) - 1))
/// as in docs/method.md M14 and shaders/scene/gaussian/gait.glsl.
/// @param phase  in turns
void apply_gait(Surfels& surfels, std::size_t surfel, double phase) {
    const GaitPhaseWindow& gait = surfels.gait[surfel];
    const double angle = 2.0 * kPi * (phase - double(gait.phase)), sharpness = double(gait.sharpness);
    surfels.mean[surfel] =
        glm::vec3(glm::dvec3(surfels.mean[surfel]) + std::sin(angle) * glm::dvec3(gait.swing));
    const double visibility = std::exp(sharpness * sharpness * (std::cos(angle) - 1.0));
    if (visibility == 1.0) return;  // keeps the exact logit
    const double opacity = visibility / (1.0 + std::exp(-double(surfels.opacity_logit[surfel])));  // sigmoid
    constexpr double kMinOpacity = 1e-30;  // keeps the logit finite
    surfels.opacity_logit[surfel] = float(std::log(std::max(opacity, kMinOpacity) / (1.0 - opacity)));
}

/// Moves surfels from their model frame to the world frame. Spherical harmonics depend on
/// directions, so their coefficients are rotated too.
void surfels_to_world(Surfels& surfels, const Pose& world_from_model) {
    const ShRotation sh_rotation = make_sh_rotation(world_from_model.rotation);
    parallel_blocks(surfels.size(), [&](std::size_t index) {
        surfels.mean[index] = glm::vec3(world_from_model * glm::dvec3(surfels.mean[index]));
        // Surfels store (w, x, y, z) in the components x, y, z, w of a vector.
        const glm::dquat q(double(surfels.rotation[index].x), double(surfels.rotation[index].y),
                           double(surfels.rotation[index].z), double(surfels.rotation[index].w));
        const glm::dquat rotated = world_from_model.rotation * q;
        surfels.rotation[index] = glm::vec4(rotated.w, rotated.x, rotated.y, rotated.z);
        for (std::size_t c = 0; c < kShChannels; ++c)
            rotate_sh(sh_rotation, &surfels.sh[index * kShFloats + c * kShCoefficients]);
    });
}

}  // namespace

Surfels freeze_scene(const Scene& scene, const std::vector<InstancePose>& poses) {
    if (poses.size() != scene.instances.size())
        fail("found {} poses of instances, expected {}", poses.size(), scene.instances.size());
    Surfels all;
    all.primitive = scene.surfels.primitive;
    for (std::size_t k = 0; k < poses.size(); ++k) {
        if (!poses[k].present) continue;
        const SurfelModel& model = scene.models[scene.instances[k].model];
        Surfels surfels = scene.surfels.slice(model.first, model.count);
        if (model.stride_m > 0.0f && surfels.bends)  // the actor walks
            for (std::size_t i = 0; i < surfels.size(); ++i) apply_gait(surfels, i, poses[k].phase);
        // The motion is now part of the positions, so the result has no gaits.
        surfels.gait.clear();
        surfels.bends = false;
        // Only the background has no track. Its surfels are already in the world frame.
        if (!scene.instances[k].track.empty()) surfels_to_world(surfels, poses[k].world_from_model);
        all.append_surfels(surfels);
    }
    return all;
}

}  // namespace relidar
