// SPDX-License-Identifier: Apache-2.0
// Seeded random scenes for tests of values and gradients. Every discontinuity of the
// image (alpha cut and clamp, near plane, order swap at equal t, T_min stop, intensity
// clamp, grazing surfels) is kept away from every ray by a margin, so that central
// differences and single precision see the same smooth function as the double reference
// (docs/architecture.md section 9).
#pragma once

#include <cstdint>
#include <vector>

#include "../reference/render.hpp"

namespace relidar::test {

struct RandomSceneOptions {
    std::uint64_t seed = 1;
    int background_surfels = 40;
    int actor_surfels = 12;   ///< one model ...
    int actor_instances = 2;  ///< ... placed this often, each with its own pose, overlapping the background
    /// of the background: at 3, 5, ... m, 4 m wide, opacity 0.997, so that alpha clamps
    int wide_surfels = 0;
    int rays = 24;
    double opacity_low = 0.05, opacity_high = 0.6;
    Primitive primitive = Primitive::surfel;
    bool moving = false;     ///< actors drive and turn during a sweep, and rays are fired at their own times
    double turn_rate = 3.0;  ///< rad/s, of actors that move
};

/// What must hold between every ray and every surfel, and along every ray.
struct Margins {
    double log_alpha = 0.02;     ///< |ln(sigma G / alpha_min)| at least this
    double log_clamp = 1e-3;     ///< |ln(sigma G / alpha_max)|: at most ln(1 / 0.99) = 0.01 where clamped
    double facing = 0.2;         ///< |n . d| of every plane a ray crosses within reach of the surfel
    double separation_m = 2e-3;  ///< between the t of consecutive hits
    double log_stop = 0.02;      ///< |ln(T / T_min)| after each hit
    double intensity = 5e-3;     ///< |intensity before the clamp|
    double near_m = 0.05;        ///< |t - near|
};

struct RandomScene {
    reference::World world;
    std::vector<reference::Ray> rays;
    glm::dvec3 view_origin{0.0};
};

/// Rounded to float, so that a kernel can be given exactly the same scene. A quarter of
/// the surfels are anisotropic by 4. Rays have measured ranges about where they meet
/// something, 0.3 m off; every seventh has none.
/// @throws std::runtime_error where too few rays keep the margins
RandomScene make_random_scene(const RandomSceneOptions& options, const reference::Settings& settings,
                              const Margins& margins = {});

/// Whether a ray keeps all margins in a world.
bool keeps_margins(const reference::World& world, const reference::Settings& settings,
                   const reference::Ray& ray, const Margins& margins);

}  // namespace relidar::test
