// SPDX-License-Identifier: Apache-2.0
// Makes random scenes with a fixed seed for tests of values and gradients. A margin is
// the minimum distance of every ray to each discontinuity of the image, so that central
// differences and single precision evaluate the same smooth function as the double
// reference (docs/architecture.md section 9).
#pragma once

#include <cstdint>
#include <vector>

#include "../reference/render.hpp"

namespace relidar::test {

struct RandomSceneOptions {
    std::uint64_t seed = 1;
    int background_surfels = 40;
    int actor_surfels = 12;  ///< surfels of the actor's model
    /// Number of instances of the actor. Each instance has a different pose and overlaps
    /// the background.
    int actor_instances = 2;
    /// Number of background surfels at 3, 5, ... m that are 4 m wide. Their opacity is
    /// 0.997, so that alpha is clamped.
    int wide_surfels = 0;
    int rays = 24;
    double opacity_low = 0.05, opacity_high = 0.6;
    PrimitiveType primitive = PrimitiveType::surfel;
    /// if true, actors move and turn during a sweep, and each ray has a firing time
    bool moving = false;
    double angular_speed_radps = 3.0;  ///< rad/s, of moving actors
};

struct Margins {
    double log_alpha = 0.02;  ///< minimum |ln(sigma G / alpha_min)|
    /// Minimum |ln(sigma G / alpha_max)|. It can be at most ln(1 / 0.99) = 0.01 if alpha
    /// is clamped.
    double log_clamp = 1e-3;
    /// Minimum |n . d| of the surfel planes that a ray crosses within the extent of the
    /// surfel.
    double facing = 0.2;
    double separation_m = 2e-3;  ///< minimum difference between the t of consecutive hits
    double log_stop = 0.02;      ///< minimum |ln(T / T_min)| after each hit
    double intensity = 5e-3;     ///< minimum |intensity| before the clamp
    double near_m = 0.05;        ///< minimum |t - near|
};

struct RandomScene {
    reference::World world;
    std::vector<reference::Ray> rays;
    glm::dvec3 view_origin{0.0};
};

/// Makes a random scene, rounded to float, so that a kernel can receive exactly the same
/// scene. A quarter of the surfels have a scale ratio of 4. Measured ranges differ from
/// the rendered ranges by about 0.3 m. Every seventh ray has no measured range.
/// @throws std::runtime_error if too few rays satisfy the margins of the options
RandomScene make_random_scene(const RandomSceneOptions& options, const reference::Settings& settings,
                              const Margins& margins = {});

/// Returns true if a ray has the minimum distances (margins) to all discontinuities of
/// the image.
bool has_margins(const reference::World& world, const reference::Settings& settings,
                 const reference::Ray& ray, const Margins& margins);

}  // namespace relidar::test
