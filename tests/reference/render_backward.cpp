// SPDX-License-Identifier: Apache-2.0
// Backward pass of the reference. M7 converts dL/d(pixel) into dL/d(alpha), dL/d(t) and
// dL/d(channels) of each blended hit. M8 propagates these through the ray-plane
// intersection to the surfel's parameters, the ray, the view origin and the pose of the
// instance.
#include "render.hpp"

namespace relidar::reference {
namespace {

/// Derivatives of the loss with respect to the values of one hit.
struct HitGradient {
    double alpha = 0.0;
    double t = 0.0;  // direct part g_D w; the part through u and v is added in geometry_backward()
    glm::dvec3 value{0.0};
    glm::dvec3 normal{0.0};  // world
};

/// Derivatives with respect to the ray and the view origin in the model's frame.
struct LocalGradient {
    glm::dvec3 origin{0.0}, direction{0.0}, view{0.0};
};

/// Adds the derivatives of distortion (summed over all pairs), blended normal and
/// likelihood (M10-M12). dL/dw_i is the derivative per weight. alpha_i scales the weight
/// w_i = alpha_i T_i and reduces all later weights by the same share.
void add_geometry(const std::vector<ShadedHit>& hits, const std::vector<RangeKernel>& kernels,
                  const PixelGradient& g, std::vector<HitGradient>& result) {
    std::vector<double> transmittance, w, d_w(hits.size(), 0.0);
    for (const ShadedHit& s : hits) {
        transmittance.push_back(w.empty() ? 1.0 : transmittance.back() * (1.0 - hits[w.size() - 1].alpha));
        w.push_back(s.alpha * transmittance.back());
    }
    for (std::size_t i = 0; i < hits.size(); ++i) {
        d_w[i] += glm::dot(g.normal, hits[i].normal) + g.likelihood * kernels[i].value;
        result[i].t += g.likelihood * w[i] * kernels[i].slope;
        for (std::size_t j = 0; j < hits.size(); ++j) {
            d_w[i] += g.distortion * w[j] * std::abs(hits[i].t - hits[j].t);
            result[i].t += g.distortion * w[i] * w[j] *
                           (hits[i].t > hits[j].t   ? 1.0
                            : hits[i].t < hits[j].t ? -1.0
                                                    : 0.0);
        }
    }
    for (std::size_t i = 0; i < hits.size(); ++i) {
        result[i].alpha += transmittance[i] * d_w[i];
        for (std::size_t k = i + 1; k < hits.size(); ++k)
            result[i].alpha -= w[k] * d_w[k] / (1.0 - hits[i].alpha);
    }
}

/// Computes the derivatives of all hits front to back (M7) from the final pixel, the
/// running sums and T before each hit.
std::vector<HitGradient> hit_gradients(const std::vector<ShadedHit>& hits,
                                       const std::vector<RangeKernel>& kernels, const Pixel& pixel,
                                       const PixelGradient& g) {
    std::vector<HitGradient> result(hits.size());
    double transmittance = 1.0;
    Pixel sum;  // C_{<=i}: without any background
    sum.drop_logit = 0.0;
    for (std::size_t i = 0; i < hits.size(); ++i) {
        const ShadedHit& s = hits[i];
        const double w = s.alpha * transmittance;
        sum.depth += w * s.t;
        sum.weight += w;
        sum.intensity += w * s.value[0];
        sum.hit_logit += w * s.value[1];
        sum.drop_logit += w * s.value[2];
        const auto slope = [&](double c, double total, double so_far) {
            return transmittance * c - (total - so_far) / (1.0 - s.alpha);
        };
        result[i].alpha = g.depth * slope(s.t, pixel.depth, sum.depth) +
                          g.weight * slope(1.0, pixel.weight, sum.weight) +
                          g.intensity * slope(s.value[0], pixel.intensity, sum.intensity) +
                          g.hit_logit * slope(s.value[1], pixel.hit_logit, sum.hit_logit) +
                          g.drop_logit * slope(s.value[2], pixel.drop_logit, sum.drop_logit);
        result[i].normal = g.normal * w;
        result[i].t = g.depth * w;
        result[i].value = w * glm::dvec3(s.intensity_clamped ? 0.0 : g.intensity, g.hit_logit, g.drop_logit);
        transmittance *= 1.0 - s.alpha;
    }
    add_geometry(hits, kernels, g, result);
    for (std::size_t i = 0; i < hits.size(); ++i)
        if (hits[i].alpha_clamped) result[i].alpha = 0.0;
    return result;
}

/// Propagates the derivative of the channels to the SH coefficients and to the direction
/// at which they are evaluated.
void value_backward(const Surfel& surfel, const Settings& settings, const LocalRay<double>& ray,
                    const glm::dvec3& view, const glm::dvec3& d_value, Surfel& d_surfel,
                    LocalGradient& d_local) {
    const bool along_ray = settings.image.sh_direction == ShDirection::ray;
    const glm::dvec3 to_mean = surfel.mean - view;
    const glm::dvec3 direction = along_ray ? ray.direction : glm::normalize(to_mean);
    const auto basis = sh_basis(direction, settings.image.sh_degree);
    const auto slope = sh_basis_gradient(direction, settings.image.sh_degree);
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

/// Propagates to the opacity and geometry of a 3D Gaussian (M9) with its precision matrix
/// M = R diag(1 / s^2) R^T and q = mean - origin:
///   t = d.Mq / d.Md,  p = t d - q,  alpha = sigma exp(-p.Mp / 2),  d.Mp = 0
void gaussian_backward(const Surfel& surfel, const LocalRay<double>& ray, const ShadedHit& s,
                       const HitGradient& g, Surfel& d_surfel, LocalGradient& d_local) {
    const Activated a = activate(surfel);
    d_surfel.opacity_logit += g.alpha * s.gauss * a.opacity * (1.0 - a.opacity);
    const glm::dvec3 scale(a.scale, *a.scale_w), inverse2 = 1.0 / (scale * scale), d = ray.direction,
                                                 q = a.mean - ray.origin;
    const glm::dmat3 diagonal(glm::dvec3(inverse2.x, 0, 0), glm::dvec3(0, inverse2.y, 0),
                              glm::dvec3(0, 0, inverse2.z));
    const glm::dmat3 precision = a.rotation * diagonal * glm::transpose(a.rotation);
    const glm::dvec3 p = s.t * d - q;
    const double d_r2 = -0.5 * g.alpha * a.opacity * s.gauss, e = g.t / glm::dot(d, precision * d);
    const glm::dvec3 d_q = precision * (e * d - 2.0 * d_r2 * p);
    d_surfel.mean += d_q;
    d_local.origin -= d_q;
    d_local.direction += precision * (2.0 * d_r2 * s.t * p + e * (q - 2.0 * s.t * d));
    const glm::dmat3 d_precision =
        d_r2 * glm::outerProduct(p, p) - 0.5 * e * (glm::outerProduct(d, p) + glm::outerProduct(p, d));
    d_surfel.rotation += rotation_matrix_vjp(surfel.rotation, 2.0 * d_precision * a.rotation * diagonal);
    const auto d_log_scale = [&](int k) {
        return -2.0 * inverse2[k] * glm::dot(a.rotation[k], d_precision * a.rotation[k]);
    };
    d_surfel.log_scale += glm::dvec2(d_log_scale(0), d_log_scale(1));
    *d_surfel.log_scale_w += d_log_scale(2);
}

/// Propagates to the opacity and geometry of a surfel (M8): alpha = sigma exp(-(u^2 +
/// v^2)/2), p = t d - q with q = mean - origin, t = n.q / n.d.
/// @param d_normal dL/d(normal) in the model frame, without the part through t
void geometry_backward(const Surfel& surfel, const LocalRay<double>& ray, const ShadedHit& s,
                       const HitGradient& g, const glm::dvec3& d_normal, Surfel& d_surfel,
                       LocalGradient& d_local) {
    const Activated a = activate(surfel);
    d_surfel.opacity_logit += g.alpha * s.gauss * a.opacity * (1.0 - a.opacity);
    const double d_u = -g.alpha * a.opacity * s.gauss * s.u;
    const double d_v = -g.alpha * a.opacity * s.gauss * s.v;
    d_surfel.log_scale += glm::dvec2(-s.u * d_u, -s.v * d_v);  // u is proportional to 1 / s_u

    const glm::dvec3 normal = a.rotation[2];
    const double facing = glm::dot(normal, ray.direction);
    const glm::dvec3 p = s.t * ray.direction - (a.mean - ray.origin);
    const glm::dvec3 d_p = a.rotation[0] * (d_u / a.scale.x) + a.rotation[1] * (d_v / a.scale.y);
    const double d_t = g.t + glm::dot(ray.direction, d_p);  // dp/dt = d
    const glm::dvec3 d_q = normal * (d_t / facing) - d_p;   // dt/dmean = n / (n.d)
    d_surfel.mean += d_q;
    d_local.origin -= d_q;
    d_local.direction += s.t * d_p - normal * (d_t * s.t / facing);
    // dt/dn = (mean - hit) / (n.d)
    const glm::dmat3 d_rotation(p * (d_u / a.scale.x), p * (d_v / a.scale.y), d_normal - p * (d_t / facing));
    d_surfel.rotation += rotation_matrix_vjp(surfel.rotation, d_rotation);
}

/// Propagates from the model's frame to the world: x_m = R^T (x_w - translation), and R
/// -> exp([w]x) R turns x_m by -R^T (w cross ...). A moving model changes in its local
/// axes, equally for all rays, as described at PoseGradient.
void pose_backward(const Placement& placed, const Ray& ray, const glm::dvec3& view_origin,
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

}  // namespace

Gradients::Gradients(const World& world) : surfels(world.surfels.size()), instances(world.instances.size()) {
    for (std::size_t i = 0; i < surfels.size(); ++i) {
        surfels[i].rotation = glm::dvec4(0.0);  // the default of Surfel is the identity rotation
        if (world.surfels[i].log_scale_w) surfels[i].log_scale_w = 0.0;
    }
}

RayGradient backward(const World& world, const HitProvider& provider, const Settings& settings,
                     const Ray& ray, int chunk, const PixelGradient& d_pixel, Gradients& gradients) {
    std::vector<ShadedHit> hits;
    const Pixel pixel = render(world, provider, settings, ray, chunk, &hits);
    std::vector<RangeKernel> kernels;
    for (const ShadedHit& s : hits) kernels.push_back(range_kernel(settings, ray, s.t));
    const std::vector<HitGradient> d_hits = hit_gradients(hits, kernels, pixel, d_pixel);
    RayGradient d_ray;
    for (std::size_t i = 0; i < hits.size(); ++i) {
        const ShadedHit& s = hits[i];
        const Surfel& surfel = world.surfels[s.hit.surfel];
        const Placement& placed = world.instances[s.hit.instance];
        const Pose pose = placed.at(ray.time_s);
        const LocalRay<double> local = to_model(pose, ray);
        const glm::dvec3 view =
            to_model(placed.world_from_model, {settings.view_origin, glm::dvec3(0.0)}).origin;
        Surfel& d_surfel = gradients.surfels[s.hit.surfel];
        LocalGradient d_local;
        glm::dvec3 d_value = d_hits[i].value;
        if (settings.image.single_drop_logit) d_value[1] = 0.0;
        value_backward(surfel, settings, local, view, d_value, d_surfel, d_local);
        if (surfel.log_scale_w) {
            gaussian_backward(surfel, local, s, d_hits[i], d_surfel, d_local);
        } else {
            const glm::dvec3 d_normal =
                s.side * (glm::transpose(glm::mat3_cast(pose.rotation)) * d_hits[i].normal);
            geometry_backward(surfel, local, s, d_hits[i], d_normal, d_surfel, d_local);
            gradients.instances[s.hit.instance].rotation +=  // the normal turns with the model
                placed.unturned(ray.time_s) * glm::cross(s.normal, d_hits[i].normal);
        }
        pose_backward(placed, ray, settings.view_origin, d_local, gradients.instances[s.hit.instance], d_ray,
                      gradients.view_origin);
    }
    return d_ray;
}

}  // namespace relidar::reference
