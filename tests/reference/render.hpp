// SPDX-License-Identifier: Apache-2.0
// The oracle's image formation in double precision: blending along a ray (M4), outputs
// (M5), and the gradients of both (M7, M8) with respect to every surfel parameter, the
// ray, the view origin and the pose of each instance. Hits come from any HitProvider;
// their order and the skip rule are the provider's, t, u, v and alpha are evaluated again
// here in double.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/diff/blended_values.h>

#include "traversal.hpp"

namespace relidar::reference {

/// How rays are rendered.
struct Settings {
    ImageModel image;
    glm::dvec3 view_origin{0.0};       ///< metres, world: where ShDirection::surfel looks from
    double likelihood_scale_m = 0.05;  ///< s of M12
};

/// A number for each blended value.
struct BlendedValues {
#define RELIDAR_FIELD(name, built, value, input, slope, meaning) double name = 0.0;
    RELIDAR_BLENDED_VALUES(RELIDAR_FIELD)
#undef RELIDAR_FIELD
};

/// What one ray brings back (M5): sum w c of each blended value c, plus T_N in drop_logit.
struct Pixel : BlendedValues {
    double transmittance = 1.0;  ///< T_N, after the last blended surfel
    /// t of the surfel that takes T from above 0.5 to 0.5 or less; 0 where none does
    double median_depth = 0.0;
    std::uint32_t hits = 0;  ///< blended surfels
    /// of the surfel of median_depth; where there is none, of the nearest blended one; -1
    /// without
    std::int64_t instance = -1;
    /// sum w n, n the surfel's unit normal in the world on the side that faces the sensor
    glm::dvec3 normal{0.0};
};

/// dL/d(Pixel) of its blended values.
using PixelGradient = BlendedValues;
/// sum of gradient times output, over all outputs: a loss with that gradient.
double inner_product(const PixelGradient& g, const Pixel& p);

/// Kernel of M12 about the range that a ray measured: s^2 / (s^2 + (t - z)^2); 0 where it
/// measured nothing.
struct RangeKernel {
    double value = 0.0;
    double slope = 0.0;  ///< dk/dt
};
RangeKernel range_kernel(const Settings& settings, const Ray& ray, double t);

/// One hit with everything blending needs.
struct ShadedHit {
    Hit hit;
    double t, u, v, w;       ///< w of a 3D Gaussian, else 0
    double gauss;            ///< G
    double alpha;            ///< min(alpha_max, sigma G)
    bool alpha_clamped;      ///< sigma G > alpha_max: no gradient through alpha
    glm::dvec3 value;        ///< channels; intensity clamped at >= 0
    double raw_intensity;    ///< before the clamp
    bool intensity_clamped;  ///< raw intensity < 0: no gradient through it
    double side;             ///< -1 where the surfel's own normal points along the ray, else 1
    glm::dvec3 normal;       ///< world, facing the sensor
};
/// Returns c of each blended value of a hit.
BlendedValues values_of(const Settings& settings, const Ray& ray, const ShadedHit& hit);
/// Returns dc/dt of each, with the channels of the hit held fixed.
BlendedValues slopes_of(const Settings& settings, const Ray& ray, const ShadedHit& hit);
ShadedHit shade(const World& world, const Settings& settings, const Ray& ray, const Hit& hit);

/// Renders a ray, `chunk` hits at a time. @param blended  if given, receives the blended
/// hits in order
Pixel render(const World& world, const HitProvider& provider, const Settings& settings, const Ray& ray,
             int chunk, std::vector<ShadedHit>* blended = nullptr);
/// The same from the list of all hits at once.
Pixel render_all_at_once(const World& world, const HitProvider& provider, const Settings& settings,
                         const Ray& ray, std::vector<ShadedHit>* blended = nullptr);

/// Some of the blended hits of a ray.
struct Surface {
    double weight = 0.0;  ///< sum w
    double mean = 0.0;    ///< sum w t / sum w, metres
};
/// M13: a hit more than a gap behind the one before begins another surface. @return
/// nearest first
std::vector<Surface> surfaces(const std::vector<ShadedHit>& blended, double gap_m);

/// Gradient with respect to an instance's pose.
///   world_from_model becomes (exp([rotation]x) R, translation' = translation + d_translation): the rotation vector is
///   expressed in the world and turns the model about its own origin; the translation is not turned.
/// Of a model that moves during a sweep these are the axes in which it is at
/// world_from_model: the pose that a ray meets is changed as
///   R(t) R^-1 (translation, rotation), so that the model moves in its own axes, alike for all rays.
struct PoseGradient {
    glm::dvec3 translation{0.0};
    glm::dvec3 rotation{0.0};
};

/// Accumulated over rays.
struct Gradients {
    std::vector<Surfel> surfels;          ///< [n] dL/d(parameter), same layout as the parameters
    std::vector<PoseGradient> instances;  ///< [instances]
    glm::dvec3 view_origin{0.0};          ///< zero unless ShDirection::surfel

    explicit Gradients(const World& world);  ///< zeros
};

/// Of one ray; the direction is a free 3-vector (not renormalised, the SH polynomials
/// take it as it is).
struct RayGradient {
    glm::dvec3 origin{0.0};
    glm::dvec3 direction{0.0};
};

/// Second cast of the ray, front to back (M7, M8): adds to `gradients`, returns the ray's
/// own.
RayGradient backward(const World& world, const HitProvider& provider, const Settings& settings,
                     const Ray& ray, int chunk, const PixelGradient& d_pixel, Gradients& gradients);

}  // namespace relidar::reference
