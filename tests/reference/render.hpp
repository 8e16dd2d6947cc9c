// SPDX-License-Identifier: Apache-2.0
// Renders rays in double precision: blending along a ray (M4), outputs (M5), and the
// gradients of both (M7, M8) with respect to every surfel parameter, the ray, the view
// origin and the pose of each instance. A HitProvider supplies the ordered hits. The
// reference computes t, u, v and alpha of each hit again in double.
#pragma once

#include <cstdint>
#include <vector>

#include "traversal.hpp"

namespace relidar::reference {

/// Settings of the reference renderer.
struct Settings {
    ImageModel image;
    glm::dvec3 view_origin{0.0};       ///< metres, world; viewpoint of ShDirection::surfel
    double likelihood_scale_m = 0.05;  ///< s of M12
};

/// Rendered values of one ray (M5).
struct Pixel {
    double depth = 0.0;          ///< D = sum w t
    double weight = 0.0;         ///< W = sum w
    double intensity = 0.0;      ///< sum w c, background 0
    double hit_logit = 0.0;      ///< sum w c, background 0
    double drop_logit = 1.0;     ///< sum w c + T_N * 1
    double transmittance = 1.0;  ///< T_N, after the last blended surfel
    /// t of the surfel at which T falls from above 0.5 to 0.5 or less; 0 if T stays above
    /// 0.5
    double median_depth = 0.0;
    std::uint32_t hits = 0;  ///< blended surfels
    /// instance of the surfel at median_depth, otherwise of the nearest blended surfel;
    /// -1 if no surfel was blended
    std::int64_t instance = -1;
    /// sum w n, where n is the unit normal of the surfel in the world, on the side facing
    /// the sensor (M11)
    glm::dvec3 normal{0.0};
    double distortion = 0.0;  ///< sum over all pairs of w_i w_j |t_i - t_j|, metres (M10)
    double likelihood = 0.0;  ///< S = sum w k(t), or 0 if the ray has no measured range (M12)
};

/// dL/d(Pixel) of the outputs that a loss can use.
struct PixelGradient {
    double depth = 0.0, weight = 0.0, intensity = 0.0, hit_logit = 0.0, drop_logit = 0.0;
    glm::dvec3 normal{0.0};
    double distortion = 0.0;
    double likelihood = 0.0;
};
/// Returns the sum of gradient times output over all outputs. Its derivative is the given
/// gradient.
double inner_product(const PixelGradient& g, const Pixel& p);

/// Kernel of M12 around the measured range z: s^2 / (s^2 + (t - z)^2), or 0 if the ray
/// has no measured range.
struct RangeKernel {
    double value = 0.0;
    double slope = 0.0;  ///< dk/dt
};
RangeKernel range_kernel(const Settings& settings, const Ray& ray, double t);

/// A hit with all values that blending needs.
struct ShadedHit {
    Hit hit;
    double t, u, v, w;       ///< w is non-zero only for a 3D Gaussian
    double gauss;            ///< G
    double alpha;            ///< min(alpha_max, sigma G)
    bool alpha_clamped;      ///< true if sigma G > alpha_max; alpha then has no gradient
    glm::dvec3 value;        ///< channels; intensity clamped at >= 0
    double raw_intensity;    ///< before the clamp
    bool intensity_clamped;  ///< true if the raw intensity is negative; it then has no gradient
    double side;             ///< -1 if the surfel's normal points along the ray, otherwise 1
    glm::dvec3 normal;       ///< world, facing the sensor
};
ShadedHit shade(const World& world, const Settings& settings, const Ray& ray, const Hit& hit);

/// Renders a ray and fetches `chunk` hits at a time.
/// @param blended if not null, receives the blended hits in order
Pixel render(const World& world, const HitProvider& provider, const Settings& settings, const Ray& ray,
             int chunk, std::vector<ShadedHit>* blended = nullptr);
/// Renders a ray from the list of all its hits, without chunks.
Pixel render_all_at_once(const World& world, const HitProvider& provider, const Settings& settings,
                         const Ray& ray, std::vector<ShadedHit>* blended = nullptr);

/// A group of consecutive blended hits of a ray that form one surface.
struct Surface {
    double weight = 0.0;  ///< sum w
    double mean = 0.0;    ///< sum w t / sum w, metres
};
/// Groups blended hits into surfaces (M13). A hit more than `gap_m` behind the previous
/// hit starts a new surface.
/// @return surfaces, nearest first
std::vector<Surface> surfaces(const std::vector<ShadedHit>& blended, double gap_m);

/// Gradient with respect to the pose of an instance.
///   world_from_model becomes (exp([rotation]x) R, translation' = translation + d_translation):
///   the rotation vector is expressed in the world and turns the model about its origin;
///   the translation is not turned.
/// For a model that moves during a sweep, the gradient is expressed in the axes at
/// world_from_model. The pose at the time of a ray changes by
///   R(t) R^-1 (translation, rotation),
/// so that the model moves in its local axes, equally for all rays.
struct PoseGradient {
    glm::dvec3 translation{0.0};
    glm::dvec3 rotation{0.0};
};

/// Gradients summed over rays.
struct Gradients {
    std::vector<Surfel> surfels;          ///< [n] dL/d(parameter), same layout as the parameters
    std::vector<PoseGradient> instances;  ///< [instances]
    glm::dvec3 view_origin{0.0};          ///< zero unless ShDirection::surfel

    explicit Gradients(const World& world);  ///< initialises all gradients with zeros
};

/// Gradient with respect to one ray. The direction is a free vector: it is not
/// normalised, and the SH polynomials use it unchanged.
struct RayGradient {
    glm::dvec3 origin{0.0};
    glm::dvec3 direction{0.0};
};

/// Casts the ray a second time, front to back (M7, M8). Adds to `gradients` and returns
/// the gradient of the ray.
RayGradient backward(const World& world, const HitProvider& provider, const Settings& settings,
                     const Ray& ray, int chunk, const PixelGradient& d_pixel, Gradients& gradients);

}  // namespace relidar::reference
