// SPDX-License-Identifier: Apache-2.0
// Makes random scenes with a seed for tests of values and gradients. Every ray keeps a
// margin to every discontinuity of the image: alpha cut and clamp, near plane, order of
// hits at equal t, T_min stop, intensity clamp, grazing surfels. Therefore central
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
    int actor_surfels = 12;  ///< surfels of the single actor model
    /// instances of the actor model, each with a different pose; they overlap the
    /// background
    int actor_instances = 2;
    /// Large background surfels at 3, 5, ... m, 4 m wide, with opacity 0.997 so that
    /// alpha is clamped.
    int wide_surfels = 0;
    int rays = 24;
    double opacity_low = 0.05, opacity_high = 0.6;
    Primitive primitive = Primitive::surfel;
    bool moving = false;     ///< actors move and turn during a sweep, and each ray has its own firing time
    double turn_rate = 3.0;  ///< rad/s, of moving actors
};

/// Minimum distances of every ray to the discontinuities of the rendering.
struct Margins {
    double log_alpha = 0.02;  ///< minimum of |ln(sigma G / alpha_min)|
    /// minimum of |ln(sigma G / alpha_max)|; clamped alphas reach at most ln(1 / 0.99) =
    /// 0.01
    double log_clamp = 1e-3;
    /// minimum |n . d| of every plane that a ray crosses within the extent of the surfel
    double facing = 0.2;
    double separation_m = 2e-3;  ///< minimum difference in t between consecutive hits
    double log_stop = 0.02;      ///< minimum of |ln(T / T_min)| after each hit
    double intensity = 5e-3;     ///< minimum of |intensity before the clamp|
    double near_m = 0.05;        ///< minimum of |t - near|
};

struct RandomScene {
    reference::World world;
    std::vector<reference::Ray> rays;
    glm::dvec3 view_origin{0.0};
};

/// Makes a random scene, rounded to float so that a kernel can receive exactly the same
/// values. A quarter of the surfels are anisotropic by a factor of 4. Measured ranges
/// differ by 0.3 m from the rendered hits; every seventh ray has no measured range.
/// @throws std::runtime_error if too few rays keep the margins
RandomScene make_random_scene(const RandomSceneOptions& options, const reference::Settings& settings,
                              const Margins& margins = {});

/// Returns true if a ray keeps all margins in the given world.
bool keeps_margins(const reference::World& world, const reference::Settings& settings,
                   const reference::Ray& ray, const Margins& margins);

}  // namespace relidar::test
