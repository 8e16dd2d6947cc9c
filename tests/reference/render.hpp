// SPDX-License-Identifier: Apache-2.0
// Implements image formation of the reference in double precision: hits, found by testing
// every surfel, blending along a ray (M4), outputs (M5), and gradients (M7, M8) with
// respect to surfel parameters, the ray, the view origin and instance poses.
#pragma once

#include <compare>
#include <cstdint>
#include <vector>

#include <relidar/diff/blended_values.h>

#include "surfel.hpp"

namespace relidar::reference {

/// A model (range of surfels) placed in the world.
struct Placement {
    std::uint32_t first = 0;
    std::uint32_t count = 0;
    Pose world_from_model;
    Motion motion = {};
    /// Additional transform of the model in its frame at all times, for finite
    /// differences. The float record ignores this transform.
    Pose change = {};

    Pose at(double time_s) const { return pose_at(world_from_model, motion, time_s) * change; }
    glm::dquat unturned(double time_s) const {
        return world_from_model.rotation * glm::conjugate(pose_at(world_from_model, motion, time_s).rotation);
    }
};

/// All objects that rays can hit. Surfel ids are indices into `surfels`, instance ids are
/// indices into `instances`.
struct World {
    std::vector<Surfel> surfels;
    std::vector<Placement> instances;
};

struct Hit {
    double t = 0.0;
    std::uint32_t instance = 0;
    std::uint32_t surfel = 0;

    friend auto operator<=>(const Hit& a, const Hit& b) = default;
};

enum class Precision { float_record, double_record };

/// Finds hits in float, so that ids are comparable with the GPU, or in double.
class BruteForce {
public:
    BruteForce(const World& world, const ImageModel& model, Precision precision);
    /// Returns all hits of a ray, in ascending order of (t, instance, surfel).
    std::vector<Hit> list_hits(const Ray& ray) const;

private:
    ImageModel model_;
    Precision precision_;
    std::vector<Placement> instances_;
    std::vector<FloatRows> rows_;
    std::vector<FloatRecord> float_records_;
    std::vector<DoubleRecord> double_records_;
};

struct Settings {
    ImageModel image;
    glm::dvec3 view_origin{0.0};       ///< metres, world: view origin for ShDirection::surfel
    double likelihood_scale_m = 0.05;  ///< s of M12
};

/// A number for each blended value of a ray.
struct BlendedValues {
#define RELIDAR_FIELD(name, built, value, input, slope, meaning) double name = 0.0;
    RELIDAR_BLENDED_VALUES(RELIDAR_FIELD)
#undef RELIDAR_FIELD
};

/// Rendered values of a ray (M5): the sum of w c for each blended value c. drop_logit
/// also contains the final transmittance T_N.
struct Pixel : BlendedValues {
    double transmittance = 1.0;  ///< T_N, after the last blended surfel
    /// Distance t of the surfel at which the transmittance T falls from above 0.5 to 0.5
    /// or less. It is 0 if T never falls so far.
    double median_depth = 0.0;
    std::uint32_t hits = 0;  ///< number of blended surfels
    /// Instance of the surfel that determines median_depth. If median_depth is 0,
    /// instance of the nearest blended surfel. -1 if no surfel was blended.
    std::int64_t instance = -1;
    /// Sum of w n, where n is the unit normal of the surfel in the world frame, on the
    /// side that faces the sensor.
    glm::dvec3 normal{0.0};
};

using PixelGradient = BlendedValues;
/// Returns the sum of gradient times output over all outputs. The gradient of this sum
/// with respect to the outputs is `gradient`.
double compute_inner_product(const PixelGradient& gradient, const Pixel& pixel);

/// Weight of a range t around the measured range z of a ray (M12): s^2 / (s^2 + (t -
/// z)^2). It is 0 if the ray has no measured range.
struct RangeKernel {
    double value = 0.0;
    double slope = 0.0;  ///< dk/dt
};
RangeKernel range_likelihood(const Settings& settings, const Ray& ray, double t);

struct ShadedHit {
    Hit hit;
    double t, u, v, w;     ///< w is 0 except for a 3D Gaussian
    double gauss;          ///< Gaussian weight G
    double alpha;          ///< min(alpha_max, sigma G)
    bool alpha_clamped;    ///< true if sigma G > alpha_max, so that alpha has no gradient
    glm::dvec3 value;      ///< channels; the intensity is clamped to >= 0
    double raw_intensity;  ///< intensity before the clamp
    /// true if the unclamped intensity is negative, so that the intensity has no gradient
    bool intensity_clamped;
    double side;        ///< -1 if the surfel's normal points along the ray, else 1
    glm::dvec3 normal;  ///< unit normal that faces the sensor, world frame
};
/// Returns c of each blended value of a hit.
BlendedValues values_of(const Settings& settings, const Ray& ray, const ShadedHit& hit);
/// Returns the derivative dc/dt of each blended value c, with the channels of the hit
/// held fixed.
BlendedValues compute_slopes(const Settings& settings, const Ray& ray, const ShadedHit& hit);
ShadedHit shade_hit(const World& world, const Settings& settings, const Ray& ray, const Hit& hit);

/// Renders a ray with all its hits.
/// @param brute hits of the world
/// @param blended if not null, receives the blended hits in order
Pixel render(const World& world, const BruteForce& brute, const Settings& settings, const Ray& ray,
             std::vector<ShadedHit>* blended = nullptr);
std::vector<Pixel> render(const World& world, const Settings& settings, const std::vector<Ray>& rays);

/// Surface: a group of consecutive blended hits of a ray.
struct Surface {
    double weight = 0.0;  ///< sum w
    double mean = 0.0;    ///< sum w t / sum w, metres
};
/// Groups hits into surfaces (M13). A hit that is more than `gap_m` behind the previous
/// hit starts a new surface.
/// @return surfaces, nearest first
std::vector<Surface> surfaces(const std::vector<ShadedHit>& blended, double gap_m);

/// Gradient with respect to an instance's pose.
///   world_from_model becomes (exp([rotation]x) R, translation' = translation + d_translation)
/// The rotation vector is expressed in the world frame and turns the model about the
/// model's origin. The translation is not turned. For a model that moves during a sweep,
/// the gradient is expressed in the axes of world_from_model. The pose at the time of a
/// ray changes by R(t) R^-1 (translation, rotation), so that the change is the same for
/// all rays in the axes of the model.
struct PoseGradient {
    glm::dvec3 translation{0.0};
    glm::dvec3 rotation{0.0};
};

/// Gradient with respect to a ray. The direction is a free 3-vector that is not
/// renormalised. The SH polynomials use it unchanged.
struct RayGradient {
    glm::dvec3 origin{0.0};
    glm::dvec3 direction{0.0};
};

struct Gradients {
    std::vector<Surfel> surfels;          ///< [n] dL/d(parameter), same layout as the parameters
    std::vector<PoseGradient> instances;  ///< [instances]
    std::vector<RayGradient> rays;        ///< [rays]
    glm::dvec3 view_origin{0.0};          ///< zero unless ShDirection::surfel

    explicit Gradients(const World& world);  ///< initialises all gradients with zero
};

/// Renders the rays again, and sums their gradients (M7, M8).
/// @param d_pixels [rays] gradients of the rendered values
Gradients backward(const World& world, const Settings& settings, const std::vector<Ray>& rays,
                   const std::vector<PixelGradient>& d_pixels);

}  // namespace relidar::reference
