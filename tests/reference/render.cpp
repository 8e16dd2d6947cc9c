// SPDX-License-Identifier: Apache-2.0
// Implements the forward pass of the reference: intersection of each surfel of each
// instance (M1, M2), shading of a hit (SH), and blending from near to far (M4, M5).
#include "render.hpp"

#include <algorithm>

namespace relidar::reference {

BruteForce::BruteForce(const World& world, const ImageModel& model, Precision precision)
    : model_(model), precision_(precision), instances_(world.instances) {
    for (const Placement& p : instances_) rows_.push_back(make_model_from_world_rows(p.world_from_model));
    for (const Surfel& s : world.surfels) {
        if (precision == Precision::float_record) float_records_.push_back(make_float_record(s));
        else double_records_.push_back(make_record(s));
    }
}

std::vector<Hit> BruteForce::list_hits(const Ray& ray) const {
    std::vector<Hit> hits;
    const auto offer = [&](const auto& hit, std::uint32_t instance, std::uint32_t surfel) {
        if (hit) hits.push_back({double(hit->t), instance, surfel});
    };
    for (std::uint32_t i = 0; i < instances_.size(); ++i) {
        const Placement& p = instances_[i];
        if (precision_ == Precision::float_record) {
            const LocalRay<float> still = to_model(rows_[i], glm::vec3(ray.origin), glm::vec3(ray.direction));
            const LocalRay<float> local = follow(still, p.world_from_model, p.motion, ray.time_s);
            for (std::uint32_t s = p.first; s < p.first + p.count; ++s)
                offer(intersect(float_records_[s], local, model_), i, s);
        } else {
            const LocalRay<double> local = to_model(p.at(ray.time_s), ray);
            for (std::uint32_t s = p.first; s < p.first + p.count; ++s)
                offer(intersect(double_records_[s], local, model_), i, s);
        }
    }
    std::ranges::sort(hits);
    return hits;
}

namespace {

class Blend {
public:
    Blend(const Settings& settings, const Ray& ray)
        : settings_(settings), ray_(ray), transmittance_min_(double(settings.image.transmittance_min)) {}

    /// Adds a surfel to the pixel. If the surfel would reduce the transmittance T below
    /// T_min, returns false and does not add it.
    bool add(const ShadedHit& hit) {
        const double next = pixel_.transmittance * (1.0 - hit.alpha);
        if (next < transmittance_min_) return false;
        const double w = hit.alpha * pixel_.transmittance;  // M4
        const BlendedValues c = values_of(settings_, ray_, hit);
#define RELIDAR_ADD(name, built, value, input, slope, meaning) pixel_.name += w * c.name;
        RELIDAR_BLENDED_VALUES(RELIDAR_ADD)
#undef RELIDAR_ADD
        if (pixel_.hits == 0) pixel_.instance = hit.hit.instance;
        if (pixel_.transmittance > 0.5 && next <= 0.5) {
            pixel_.median_depth = hit.t;
            pixel_.instance = hit.hit.instance;
        }
        pixel_.normal += w * hit.normal;
        pixel_.transmittance = next;
        pixel_.hits += 1;
        return true;
    }

    Pixel finish() const {
        Pixel result = pixel_;
        result.drop_logit += pixel_.transmittance;
        return result;
    }

private:
    const Settings& settings_;
    const Ray& ray_;
    double transmittance_min_;
    Pixel pixel_;
};

}  // namespace

double compute_inner_product(const PixelGradient& gradient, const Pixel& pixel) {
    double sum = 0.0;
#define RELIDAR_ADD(name, built, value, input, slope, meaning) sum += gradient.name * pixel.name;
    RELIDAR_BLENDED_VALUES(RELIDAR_ADD)
#undef RELIDAR_ADD
    return sum;
}

BlendedValues values_of(const Settings& settings, const Ray& ray, const ShadedHit& hit) {
    return {.depth = hit.t,
            .weight = 1.0,
            .intensity = hit.value[0],
            .hit_logit = hit.value[1],
            .drop_logit = hit.value[2],
            .likelihood = range_likelihood(settings, ray, hit.t).value};
}

BlendedValues compute_slopes(const Settings& settings, const Ray& ray, const ShadedHit& hit) {
    BlendedValues slopes;
    slopes.depth = 1.0;
    slopes.likelihood = range_likelihood(settings, ray, hit.t).slope;
    return slopes;
}

RangeKernel range_likelihood(const Settings& settings, const Ray& ray, double t) {
    if (!(ray.measured_m > 0.0)) return {};
    const double s = settings.likelihood_scale_m, d = t - ray.measured_m;
    const double both = s * s + d * d;
    return {s * s / both, -2.0 * d * s * s / (both * both)};
}

ShadedHit shade_hit(const World& world, const Settings& settings, const Ray& ray, const Hit& hit) {
    const Surfel& surfel = world.surfels[hit.surfel];
    const Pose pose = world.instances[hit.instance].at(ray.time_s);
    const Activated a = activate(surfel);
    const LocalRay<double> local = to_model(pose, ray);
    ShadedHit s{};
    s.hit = hit;
    const PlaneHit<double> met = meet(make_record(surfel), local);  // M1, M2 or M9
    s.t = met.t;
    s.u = met.u;
    s.v = met.v;
    s.w = met.w;
    s.gauss = std::exp(-0.5 * (s.u * s.u + s.v * s.v + s.w * s.w));
    const glm::dvec3 normal = a.rotation[2];
    s.side = glm::dot(normal, local.direction) > 0.0 ? -1.0 : 1.0;
    s.normal = s.side * (glm::mat3_cast(pose.rotation) * normal);
    const double alpha_max = double(settings.image.alpha_max);
    s.alpha_clamped = a.opacity * s.gauss > alpha_max;
    s.alpha = s.alpha_clamped ? alpha_max : a.opacity * s.gauss;
    const glm::dvec3 view =
        to_model(world.instances[hit.instance].world_from_model, {settings.view_origin, glm::dvec3(0.0)})
            .origin;
    const glm::dvec3 direction =
        settings.image.sh_direction == ShDirection::ray ? local.direction : glm::normalize(a.mean - view);
    s.value = evaluate_sh(surfel, direction, settings.image.sh_degree);
    s.raw_intensity = s.value[0];
    s.intensity_clamped = s.raw_intensity < 0.0;
    s.value[0] = std::max(s.raw_intensity, 0.0);
    if (settings.image.single_drop_logit) s.value[1] = 0.0;
    return s;
}

Pixel render(const World& world, const BruteForce& brute, const Settings& settings, const Ray& ray,
             std::vector<ShadedHit>* blended) {
    Blend blend(settings, ray);
    for (const Hit& hit : brute.list_hits(ray)) {
        const ShadedHit s = shade_hit(world, settings, ray, hit);
        if (!blend.add(s)) break;
        if (blended != nullptr) blended->push_back(s);
    }
    return blend.finish();
}

std::vector<Pixel> render(const World& world, const Settings& settings, const std::vector<Ray>& rays) {
    const BruteForce brute(world, settings.image, Precision::double_record);
    std::vector<Pixel> pixels;
    for (const Ray& ray : rays) pixels.push_back(render(world, brute, settings, ray));
    return pixels;
}

std::vector<Surface> surfaces(const std::vector<ShadedHit>& blended, double gap_m) {
    std::vector<Surface> result;
    double transmittance = 1.0;
    for (std::size_t i = 0; i < blended.size(); ++i) {
        if (i == 0 || blended[i].t - blended[i - 1].t > gap_m) result.emplace_back();
        Surface& s = result.back();
        const double w = blended[i].alpha * transmittance;
        s.mean = (s.weight * s.mean + w * blended[i].t) / (s.weight + w);
        s.weight += w;
        transmittance *= 1.0 - blended[i].alpha;
    }
    return result;
}

}  // namespace relidar::reference
