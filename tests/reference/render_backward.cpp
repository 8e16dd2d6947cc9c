// SPDX-License-Identifier: Apache-2.0
// Implements the backward pass of the reference. M7 converts dL/d(pixel) to dL/d(alpha),
// dL/d(t) and dL/d(channels) of each blended hit. M8 propagates these derivatives through
// the ray-plane intersection to the surfel's parameters, the ray, the view origin and the
// instance's pose.
#include "render.hpp"

namespace relidar::reference {
namespace {

struct HitGradient {
    double alpha = 0.0;
    // Direct derivative with respect to t. The derivative through u and v is added later.
    double t = 0.0;
    glm::dvec3 value{0.0};
};

struct LocalGradient {
    glm::dvec3 origin{0.0}, direction{0.0}, view{0.0};
};

/// Computes the gradients of all hits front to back (M7). Uses the final pixel, the
/// running sums, and T before each hit.
std::vector<HitGradient> compute_hit_gradients(const std::vector<ShadedHit>& hits, const Settings& settings,
                                               const Ray& ray, const Pixel& pixel,
                                               const PixelGradient& gradient) {
    std::vector<HitGradient> result(hits.size());
    double transmittance = 1.0;
    BlendedValues sum;  // C_{<=i} without the background
    for (std::size_t i = 0; i < hits.size(); ++i) {
        const ShadedHit& s = hits[i];
        const double w = s.alpha * transmittance;
        const BlendedValues c = values_of(settings, ray, s), by_t = compute_slopes(settings, ray, s);
#define RELIDAR_VALUE(name, built, value, input, slope, meaning)                                             \
    sum.name += w * c.name;                                                                                  \
    result[i].alpha += gradient.name * (transmittance * c.name - (pixel.name - sum.name) / (1.0 - s.alpha)); \
    result[i].t += gradient.name * w * by_t.name;
        RELIDAR_BLENDED_VALUES(RELIDAR_VALUE)
#undef RELIDAR_VALUE
        if (s.alpha_clamped) result[i].alpha = 0.0;
        result[i].value = w * glm::dvec3(s.intensity_clamped ? 0.0 : gradient.intensity, gradient.hit_logit,
                                         gradient.drop_logit);
        transmittance *= 1.0 - s.alpha;
    }
    return result;
}

/// Propagates the channel gradients to the SH coefficients and to the direction.
void backpropagate_values(const Surfel& surfel, const Settings& settings, const LocalRay<double>& ray,
                          const glm::dvec3& view, const glm::dvec3& d_value, Surfel& d_surfel,
                          LocalGradient& d_local) {
    const bool along_ray = settings.image.sh_direction == ShDirection::ray;
    const glm::dvec3 to_mean = surfel.mean - view;
    const glm::dvec3 direction = along_ray ? ray.direction : glm::normalize(to_mean);
    const auto basis = sh_basis(direction, settings.image.sh_degree);
    const auto slope = compute_sh_basis_gradient(direction, settings.image.sh_degree);
    glm::dvec3 d_direction(0.0);
    for (int channel = 0; channel < kShChannels; ++channel)
        for (int k = 0; k < kShCoefficients; ++k) {
            const int entry = channel * kShCoefficients + k;
            d_surfel.sh[entry] += d_value[channel] * basis[k];
            d_direction += d_value[channel] * surfel.sh[entry] * slope[k];
        }
    if (along_ray) {
        d_local.direction += d_direction;
    } else {
        const glm::dvec3 d_to_mean =
            (d_direction - direction * glm::dot(direction, d_direction)) / glm::length(to_mean);
        d_surfel.mean += d_to_mean;
        d_local.view -= d_to_mean;
    }
}

/// Propagates gradients to opacity and geometry of a 3D Gaussian (M9). Uses its precision
/// matrix M = R diag(1 / s^2) R^T and q = mean - origin:
///   t = d.Mq / d.Md,  p = t d - q,  alpha = sigma exp(-p.Mp / 2),  d.Mp = 0
void backpropagate_gaussian(const Surfel& surfel, const LocalRay<double>& ray, const ShadedHit& s,
                            const HitGradient& gradient, Surfel& d_surfel, LocalGradient& d_local) {
    const Activated a = activate(surfel);
    d_surfel.opacity_logit += gradient.alpha * s.gauss * a.opacity * (1.0 - a.opacity);
    const glm::dvec3 scale(a.scale, *a.scale_w), inverse2 = 1.0 / (scale * scale), d = ray.direction,
                                                 q = a.mean - ray.origin;
    const glm::dmat3 diagonal(glm::dvec3(inverse2.x, 0, 0), glm::dvec3(0, inverse2.y, 0),
                              glm::dvec3(0, 0, inverse2.z));
    const glm::dmat3 precision = a.rotation * diagonal * glm::transpose(a.rotation);
    const glm::dvec3 p = s.t * d - q;
    const double d_r2 = -0.5 * gradient.alpha * a.opacity * s.gauss,
                 e = gradient.t / glm::dot(d, precision * d);
    const glm::dvec3 d_q = precision * (e * d - 2.0 * d_r2 * p);
    d_surfel.mean += d_q;
    d_local.origin -= d_q;
    d_local.direction += precision * (2.0 * d_r2 * s.t * p + e * (q - 2.0 * s.t * d));
    const glm::dmat3 d_precision =
        d_r2 * glm::outerProduct(p, p) - 0.5 * e * (glm::outerProduct(d, p) + glm::outerProduct(p, d));
    d_surfel.rotation += rotation_vjp(surfel.rotation, 2.0 * d_precision * a.rotation * diagonal);
    const auto d_log_scale = [&](int k) {
        return -2.0 * inverse2[k] * glm::dot(a.rotation[k], d_precision * a.rotation[k]);
    };
    d_surfel.log_scale += glm::dvec2(d_log_scale(0), d_log_scale(1));
    *d_surfel.log_scale_w += d_log_scale(2);
}

/// Propagates gradients to opacity and geometry of a surfel (M8), with q = mean - origin:
///   alpha = sigma exp(-(u^2 + v^2)/2),  p = t d - q,  t = n.q / n.d
void backpropagate_geometry(const Surfel& surfel, const LocalRay<double>& ray, const ShadedHit& s,
                            const HitGradient& gradient, Surfel& d_surfel, LocalGradient& d_local) {
    const Activated a = activate(surfel);
    d_surfel.opacity_logit += gradient.alpha * s.gauss * a.opacity * (1.0 - a.opacity);
    const double d_u = -gradient.alpha * a.opacity * s.gauss * s.u;
    const double d_v = -gradient.alpha * a.opacity * s.gauss * s.v;
    d_surfel.log_scale += glm::dvec2(-s.u * d_u, -s.v * d_v);  // u is proportional to 1 / s_u

    const glm::dvec3 normal = a.rotation[2];
    const double facing = glm::dot(normal, ray.direction);
    const glm::dvec3 p = s.t * ray.direction - (a.mean - ray.origin);
    const glm::dvec3 d_p = a.rotation[0] * (d_u / a.scale.x) + a.rotation[1] * (d_v / a.scale.y);
    const double d_t = gradient.t + glm::dot(ray.direction, d_p);  // dp/dt = d
    const glm::dvec3 d_q = normal * (d_t / facing) - d_p;          // dt/dmean = n / (n.d)
    d_surfel.mean += d_q;
    d_local.origin -= d_q;
    d_local.direction += s.t * d_p - normal * (d_t * s.t / facing);
    // dt/dn = (mean - hit) / (n.d)
    const glm::dmat3 d_rotation(p * (d_u / a.scale.x), p * (d_v / a.scale.y), -p * (d_t / facing));
    d_surfel.rotation += rotation_vjp(surfel.rotation, d_rotation);
}

/// Transforms gradients from the model's frame to the world frame. The point is x_m = R^T
/// (x_w - translation), and R -> exp([w]x) R changes x_m by -R^T (w cross ...).
/// PoseGradient describes the convention for moving models.
void backpropagate_pose(const Placement& placed, const Ray& ray, const glm::dvec3& view_origin,
                        const LocalGradient& d_local, PoseGradient& d_pose, RayGradient& d_ray,
                        glm::dvec3& d_view) {
    const Pose pose = placed.at(ray.time_s), &viewed = placed.world_from_model;
    const glm::dvec3 origin = pose.rotation * d_local.origin, direction = pose.rotation * d_local.direction,
                     view = viewed.rotation * d_local.view;
    d_ray.origin += origin;
    d_ray.direction += direction;
    d_view += view;
    d_pose.translation -= placed.unturned(ray.time_s) * origin + view;
    d_pose.rotation -= placed.unturned(ray.time_s) * (glm::cross(ray.origin - pose.translation, origin) +
                                                      glm::cross(ray.direction, direction)) +
                       glm::cross(view_origin - viewed.translation, view);
}

/// Adds the gradients of a ray.
void add_ray(const World& world, const BruteForce& brute, const Settings& settings, const Ray& ray,
             const PixelGradient& d_pixel, Gradients& gradients) {
    std::vector<ShadedHit> hits;
    const Pixel pixel = render(world, brute, settings, ray, &hits);
    const std::vector<HitGradient> d_hits = compute_hit_gradients(hits, settings, ray, pixel, d_pixel);
    RayGradient& d_ray = gradients.rays.emplace_back();
    for (std::size_t i = 0; i < hits.size(); ++i) {
        const ShadedHit& s = hits[i];
        const Surfel& surfel = world.surfels[s.hit.surfel];
        const Placement& placed = world.instances[s.hit.instance];
        const LocalRay<double> local = to_model(placed.at(ray.time_s), ray);
        const glm::dvec3 view =
            to_model(placed.world_from_model, {settings.view_origin, glm::dvec3(0.0)}).origin;
        Surfel& d_surfel = gradients.surfels[s.hit.surfel];
        LocalGradient d_local;
        glm::dvec3 d_value = d_hits[i].value;
        if (settings.image.single_drop_logit) d_value[1] = 0.0;
        backpropagate_values(surfel, settings, local, view, d_value, d_surfel, d_local);
        if (surfel.log_scale_w) backpropagate_gaussian(surfel, local, s, d_hits[i], d_surfel, d_local);
        else backpropagate_geometry(surfel, local, s, d_hits[i], d_surfel, d_local);
        backpropagate_pose(placed, ray, settings.view_origin, d_local, gradients.instances[s.hit.instance],
                           d_ray, gradients.view_origin);
    }
}

}  // namespace

Gradients::Gradients(const World& world) : surfels(world.surfels.size()), instances(world.instances.size()) {
    for (std::size_t i = 0; i < surfels.size(); ++i) {
        // The default rotation of a Surfel is the identity. A gradient must start at
        // zero.
        surfels[i].rotation = glm::dvec4(0.0);
        if (world.surfels[i].log_scale_w) surfels[i].log_scale_w = 0.0;
    }
}

Gradients backward(const World& world, const Settings& settings, const std::vector<Ray>& rays,
                   const std::vector<PixelGradient>& d_pixels) {
    const BruteForce brute(world, settings.image, Precision::double_record);
    Gradients gradients(world);
    for (std::size_t i = 0; i < rays.size(); ++i)
        add_ray(world, brute, settings, rays[i], d_pixels[i], gradients);
    return gradients;
}

}  // namespace relidar::reference
