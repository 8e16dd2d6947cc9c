// SPDX-License-Identifier: Apache-2.0
// Makes random scenes without rays close to discontinuities. Surfels are placed in a
// corridor in front of the sensor and face it within 50 degrees. A random ray into the
// corridor is used only if it has a minimum distance (margin) to the discontinuities of
// M1, M2, M4 and of the intensity clamp.
#include "random_scene.hpp"

#include <cmath>
#include <random>
#include <stdexcept>

#include "surfels.hpp"

namespace relidar::test {
namespace {

using Random = std::mt19937_64;

double uniform(Random& random, double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random);
}

glm::dvec3 draw_unit_vector(Random& random) {
    std::normal_distribution<double> normal;
    return glm::normalize(glm::dvec3(normal(random), normal(random), normal(random)));
}

/// Returns a random quaternion (w, x, y, z). Its third axis lies within `cone_rad` of -x
/// or +x. The in-plane angle and the length are random.
glm::dvec4 make_facing_rotation_of_surfel(Random& random, double cone_rad) {
    const double angle = uniform(random, 0.0, 2.0 * kPi), tilt = uniform(random, 0.0, cone_rad),
                 side = uniform(random, 0.0, 1.0);
    const glm::dvec3 tilt_axis(0.0, std::cos(angle), std::sin(angle));
    const glm::dquat to_x = glm::angleAxis(side < 0.5 ? kPi / 2 : -kPi / 2, glm::dvec3(0, 1, 0));
    const glm::dquat q = glm::angleAxis(tilt, tilt_axis) * to_x *
                         glm::angleAxis(uniform(random, 0.0, 2.0 * kPi), glm::dvec3(0, 0, 1));
    return uniform(random, 0.5, 2.0) * glm::dvec4(q.w, q.x, q.y, q.z);
}

reference::Surfel make_random_surfel(Random& random, const glm::dvec3& low, const glm::dvec3& high,
                                     const RandomSceneOptions& options) {
    std::normal_distribution<double> normal;
    reference::Surfel s;
    s.mean = {uniform(random, low.x, high.x), uniform(random, low.y, high.y), uniform(random, low.z, high.z)};
    s.rotation = make_facing_rotation_of_surfel(random, 50.0 / 180.0 * kPi);
    const double size = std::log(uniform(random, 0.15, 0.5)),
                 stretch = uniform(random, 0.0, 1.0) < 0.25 ? std::log(2.0) : 0.0;
    s.log_scale = {size + stretch, size - stretch};
    const double opacity = uniform(random, options.opacity_low, options.opacity_high);
    s.opacity_logit = std::log(opacity / (1.0 - opacity));
    if (options.primitive == PrimitiveType::gaussian)
        s.log_scale_w = size + uniform(random, std::log(0.2), std::log(1.5));
    for (int k = 0; k < kShFloats; ++k) s.sh[k] = (k % kShCoefficients == 0 ? 0.8 : 0.15) * normal(random);
    return s;
}

/// Returns true if a surfel has the minimum distances (margins) to all discontinuities
/// for a ray. Alpha must not be close to its limits, the surfel must not be grazing, and
/// the hit must not be at the near plane.
bool is_surfel_smooth(const reference::Surfel& surfel, const reference::Ray& ray,
                      const reference::LocalRay<double>& local, const reference::Settings& settings,
                      const Margins& margins) {
    const reference::DoubleRecord r = reference::make_record(surfel);
    const bool is_flat = r.primitive == PrimitiveType::surfel;
    const double facing = is_flat ? glm::dot(r.normal, local.direction) / glm::length(ray.direction) : 1.0;
    const reference::PlaneHit<double> met = reference::meet(r, local);
    const double t = met.t,
                 log_alpha = std::log(r.sigma) - 0.5 * (met.u * met.u + met.v * met.v + met.w * met.w);
    if (std::abs(log_alpha - std::log(double(settings.image.alpha_min))) < margins.log_alpha) return false;
    if (std::abs(log_alpha - std::log(double(settings.image.alpha_max))) < margins.log_clamp) return false;
    // the ray does not hit this surfel, so its remaining distances do not matter
    if (log_alpha < std::log(double(settings.image.alpha_min))) return true;
    return std::abs(facing) >= margins.facing &&
           std::abs(t - double(settings.image.near_m)) >= margins.near_m;
}

/// Returns true if the sorted hits have the minimum distances (margins) to a change of
/// their order, to the stop rule, and to the intensity clamp.
bool are_hits_smooth(const reference::World& world, const reference::Settings& settings,
                     const reference::Ray& ray, const Margins& margins) {
    const reference::BruteForce brute(world, settings.image, reference::Precision::double_record);
    const std::vector<reference::Hit> hits = brute.list_hits(ray);
    double transmittance = 1.0;
    for (std::size_t i = 0; i < hits.size(); ++i) {
        const reference::ShadedHit s = reference::shade_hit(world, settings, ray, hits[i]);
        if (i > 0 && hits[i].t - hits[i - 1].t < margins.separation_m) return false;
        if (std::abs(s.raw_intensity) < margins.intensity) return false;
        transmittance *= 1.0 - s.alpha;
        if (std::abs(std::log(transmittance / double(settings.image.transmittance_min))) < margins.log_stop)
            return false;
        if (transmittance < double(settings.image.transmittance_min)) return true;
    }
    return true;
}

/// Returns random surfels, placements and a view origin. Values are rounded to float if
/// the library stores them as float.
RandomScene make_random_surfels(Random& random, const RandomSceneOptions& options) {
    RandomScene scene;
    std::vector<reference::Surfel> surfels;
    for (int i = 0; i < options.background_surfels; ++i)
        surfels.push_back(make_random_surfel(random, {2, -0.6, -0.6}, {10, 0.6, 0.6}, options));
    for (int i = 0; i < options.actor_surfels; ++i)
        surfels.push_back(make_random_surfel(random, {-1, -0.5, -0.5}, {1, 0.5, 0.5}, options));
    for (int i = 0; i < options.wide_surfels; ++i) {
        surfels[std::size_t(i)].log_scale = glm::dvec2(std::log(4.0));
        if (options.primitive == PrimitiveType::gaussian) surfels[std::size_t(i)].log_scale_w = std::log(0.5);
        surfels[std::size_t(i)].mean = {3.0 + 2.0 * i, 0.0, 0.0};
        surfels[std::size_t(i)].opacity_logit = std::log(0.997 / 0.003);
    }
    scene.world.surfels = to_reference(to_surfels(surfels));
    const auto n_background = std::uint32_t(options.background_surfels);
    scene.world.instances.push_back({0, n_background, {}});
    for (int i = 0; i < options.actor_instances; ++i) {
        const double angle = uniform(random, -0.5, 0.5);
        const glm::dquat rotation = glm::angleAxis(angle, draw_unit_vector(random));
        const glm::dvec3 position_m(uniform(random, 4, 8), uniform(random, -0.4, 0.4),
                                    uniform(random, -0.4, 0.4));
        scene.world.instances.push_back(
            {n_background, std::uint32_t(options.actor_surfels), {rotation, position_m}});
        if (options.moving)
            scene.world.instances.back().motion = {5.0 * draw_unit_vector(random),
                                                   options.angular_speed_radps * draw_unit_vector(random),
                                                   double(float(0.01 * i)), double(0.05f)};
    }
    scene.view_origin = glm::dvec3(glm::vec3(uniform(random, -0.3, 0.3), uniform(random, -0.3, 0.3), 0.2));
    return scene;
}

/// Adds random rays with the minimum distances to discontinuities, until enough rays
/// exist or the number of attempts is exhausted.
void add_rays(Random& random, const RandomSceneOptions& options, const reference::Settings& settings,
              const Margins& margins, RandomScene& scene) {
    for (int attempt = 0; attempt < 200 * options.rays && int(scene.rays.size()) < options.rays; ++attempt) {
        const glm::dvec3 origin(uniform(random, -0.3, 0.3), uniform(random, -0.3, 0.3),
                                uniform(random, -0.3, 0.3));
        const glm::dvec3 towards(8.0, uniform(random, -0.8, 0.8), uniform(random, -0.8, 0.8));
        reference::Ray ray{glm::dvec3(glm::vec3(origin)),
                           glm::dvec3(glm::vec3(glm::normalize(towards - origin)))};
        if (options.moving) ray.time_s = double(float(uniform(random, -0.07, 0.07)));
        if (has_margins(scene.world, settings, ray, margins)) scene.rays.push_back(ray);
    }
}

void add_measured_ranges(const RandomSceneOptions& options, const reference::Settings& settings,
                         RandomScene& scene) {
    Random random(options.seed + 1000);
    std::normal_distribution<double> normal;
    const std::vector<reference::Pixel> pixels = reference::render(scene.world, settings, scene.rays);
    for (std::size_t i = 0; i < scene.rays.size(); ++i) {
        const reference::Pixel& p = pixels[i];
        const double off = 0.3 * normal(random);
        if (i % 7 != 3 && p.hits > 0)
            scene.rays[i].measured_m = double(float(std::max(p.depth / p.weight + off, 0.5)));
    }
}

}  // namespace

bool has_margins(const reference::World& world, const reference::Settings& settings,
                 const reference::Ray& ray, const Margins& margins) {
    for (const reference::Placement& p : world.instances) {
        const auto local = reference::to_model(p.at(ray.time_s), ray);
        for (std::uint32_t s = p.first; s < p.first + p.count; ++s)
            if (!is_surfel_smooth(world.surfels[s], ray, local, settings, margins)) return false;
    }
    return are_hits_smooth(world, settings, ray, margins);
}

RandomScene make_random_scene(const RandomSceneOptions& options, const reference::Settings& settings,
                              const Margins& margins) {
    Random random(options.seed);
    // makes several attempts, because a single surfel (say, with an intensity near 0) can
    // reject every ray
    for (int attempt = 0; attempt < 50; ++attempt) {
        RandomScene scene = make_random_surfels(random, options);
        reference::Settings viewed = settings;
        viewed.view_origin = scene.view_origin;
        add_rays(random, options, viewed, margins, scene);
        if (int(scene.rays.size()) < options.rays) continue;
        add_measured_ranges(options, viewed, scene);
        return scene;
    }
    throw std::runtime_error("make_random_scene: too few rays keep the margins");
}

}  // namespace relidar::test
