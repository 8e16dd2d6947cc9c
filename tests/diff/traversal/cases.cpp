// SPDX-License-Identifier: Apache-2.0
// Builds the conformance cases of traversal. All random numbers are drawn from
// std::mt19937_64 with a fixed seed.
#include "cases.hpp"

#include <cmath>
#include <limits>
#include <random>

#include "../../support/surfels.hpp"

namespace relidar::test {
namespace {

using reference::Surfel;
using Random = std::mt19937_64;

double uniform(Random& random, double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random);
}

glm::dvec3 draw_uniform_point(Random& random, double half) {
    const double x = uniform(random, -half, half), y = uniform(random, -half, half),
                 z = uniform(random, -half, half);
    return {x, y, z};
}

glm::dvec3 draw_unit_vector(Random& random) {
    std::normal_distribution<double> normal;
    return glm::normalize(glm::dvec3(normal(random), normal(random), normal(random)));
}

double logit(double probability) { return std::log(probability / (1.0 - probability)); }

/// Returns a surfel at (x, 0, 0) that faces the x axis: a_u = y, a_v = z.
Surfel make_facing_surfel(double value, double scale_m, double opacity) {
    Surfel s;
    s.mean = {value, 0, 0};
    s.rotation = {0.5, 0.5, 0.5, 0.5};
    s.log_scale = glm::dvec2(std::log(scale_m));
    s.opacity_logit = logit(opacity);
    return s;
}

/// Returns a surfel with random orientation (quaternion not normalised), standard
/// deviations of 0.03 to 0.5 m, and an opacity between alpha_min and 0.99.
Surfel make_random_surfel(Random& random, double half_m) {
    std::normal_distribution<double> normal;
    Surfel s;
    s.mean = draw_uniform_point(random, half_m);
    s.rotation = {normal(random), normal(random), normal(random), normal(random)};
    s.log_scale = {uniform(random, std::log(0.03), std::log(0.5)),
                   uniform(random, std::log(0.03), std::log(0.5))};
    s.opacity_logit = logit(std::exp(uniform(random, std::log(0.005), std::log(0.99))));
    return s;
}

void add_ray(TraversalCase& test_case, const glm::dvec3& origin, const glm::dvec3& direction) {
    test_case.rays.origin.emplace_back(origin);
    test_case.rays.direction.emplace_back(glm::normalize(direction));
}

std::vector<reference::Placement> make_one_instance(std::size_t count) {
    return {{0, std::uint32_t(count), {}}};
}

double compute_proxy_factor(const Surfel& surfel) {
    return std::sqrt(2.0 * std::log(255.0 / (1.0 + std::exp(-surfel.opacity_logit))));
}

}  // namespace

reference::World to_world(const TraversalCase& test_case) {
    return {to_reference(test_case.surfels), test_case.instances};
}

TraversalCase make_empty_case() {
    TraversalCase c{"empty", {}, {}, {}};
    add_ray(c, {0, 0, 0}, {1, 0, 0});
    add_ray(c, {1, 2, 3}, {0, -1, 1});
    return c;
}

TraversalCase make_single_case() {
    TraversalCase c{"single", to_surfels({make_facing_surfel(5, 0.5, 0.8)}), make_one_instance(1), {}};
    add_ray(c, {0, 0, 0}, {1, 0, 0});
    add_ray(c, {0, 0.3, -0.4}, {1, 0, 0});
    add_ray(c, {10, 0.3, -0.4}, {-1, 0, 0});  // from the back
    add_ray(c, {0, 0, 0}, {-1, 0, 0});        // behind the sensor
    add_ray(c, {5, -3, 0}, {0, 1, 0});        // in the plane
    add_ray(c, {4, -3, 0}, {0, 1, 0});        // parallel to it
    add_ray(c, {4.79, 0, 0}, {1, 0, 0});      // just beyond the near limit of 0.2 m
    add_ray(c, {4.81, 0, 0}, {1, 0, 0});      // just within
    add_ray(c, {0, 3, 0}, {1, 0, 0});         // misses the surfel
    return c;
}

TraversalCase make_equal_depth_case() {
    const Surfel s = make_facing_surfel(0, 0.5, 0.3);
    TraversalCase c{"equal depth", to_surfels(std::vector<Surfel>(7, s)), {}, {}};
    const Pose at_five{glm::dquat(1, 0, 0, 0), {5, 0, 0}}, at_six{glm::dquat(1, 0, 0, 0), {6, 0, 0}};
    c.instances = {{0, 7, at_five}, {0, 7, at_six}, {0, 7, at_five}, {3, 2, at_five}};
    Random random(7);
    for (int i = 0; i < 50; ++i)
        add_ray(c, {0, 0, 0}, glm::dvec3(5, uniform(random, -1, 1), uniform(random, -1, 1)));
    // the ray passes the diagonal that the two triangles around each surfel share
    add_ray(c, {0, 0, 0}, {1, 0, 0});
    return c;
}

TraversalCase make_long_list_case() {
    std::vector<Surfel> surfels;
    for (int i = 0; i < 100; ++i)
        surfels.push_back(make_facing_surfel(1 + ((i * 37) % 100) * 0.1, 1.0, 0.05));
    TraversalCase c{"long list", to_surfels(surfels), make_one_instance(100), {}};
    Random random(8);
    for (int i = 0; i < 20; ++i)
        add_ray(c, {0, 0, 0}, {11, uniform(random, -0.5, 0.5), uniform(random, -0.5, 0.5)});
    return c;
}

TraversalCase make_tied_list_case(int count) {
    std::vector<Surfel> surfels;
    for (int i = 0; i < count; ++i) {
        surfels.push_back(make_facing_surfel(1 + (i * 37) % (count / 3 + 1) * 0.01, 1.0, 0.01));
        // surfels at equal distance are not in the order of their ids
        surfels.back().mean.y = (3 - i % 7) * 0.05;
    }
    TraversalCase c{
        "list of " + std::to_string(count), to_surfels(surfels), make_one_instance(surfels.size()), {}};
    Random random(9);
    for (int i = 0; i < 6; ++i)
        add_ray(c, {0, 0, 0}, {11, uniform(random, -0.5, 0.5), uniform(random, -0.5, 0.5)});
    return c;
}

TraversalCase make_outline_case(std::uint64_t seed, int n_rays) {
    Random random(seed);
    std::vector<Surfel> surfels;
    for (int i = 0; i < 60; ++i) surfels.push_back(make_random_surfel(random, 3.0));
    TraversalCase c{"outline", to_surfels(surfels), make_one_instance(surfels.size()), {}};
    for (int i = 0; i < n_rays; ++i) {
        const Surfel& s = surfels[std::size_t(i) % surfels.size()];
        const reference::Activated a = reference::activate(s);
        const double k = compute_proxy_factor(s), along = uniform(random, -1, 1),
                     angle = uniform(random, 0, 2 * kPi);
        const double side = uniform(random, 0, 1) < 0.5 ? -1.0 : 1.0, rim = i % 2 == 0 ? 0.99 : 1.01;
        const glm::dvec2 on_rim = rim * glm::dvec2(std::cos(angle), std::sin(angle));
        const glm::dvec2 spots[6] = {{along, along}, {along, -along}, {along, side},
                                     {side, along},  {side, -side},   on_rim};
        const glm::dvec2 half = i % 6 == 5 ? k * a.scale : k * a.scale * 1.002 + 1e-4;
        const glm::dvec2 spot = spots[i % 6] * half;
        const glm::dvec3 target = a.mean + spot.x * a.rotation[0] + spot.y * a.rotation[1];
        const glm::dvec3 origin =
            target + uniform(random, 1, 6) * glm::normalize(a.rotation[2] + 0.8 * draw_unit_vector(random));
        add_ray(c, origin, target - origin);
    }
    return c;
}

TraversalCase make_grazing_case(std::uint64_t seed, int n_rays) {
    Random random(seed);
    std::vector<Surfel> surfels;
    for (int i = 0; i < 200; ++i) surfels.push_back(make_random_surfel(random, 6.0));
    TraversalCase c{"grazing", to_surfels(surfels), make_one_instance(surfels.size()), {}, true};
    for (int i = 0; i < n_rays; ++i) {
        const Surfel& s = surfels[std::size_t(i) % surfels.size()];
        const reference::Activated a = reference::activate(s);
        const double r = uniform(random, 0, 1.05) * compute_proxy_factor(s),
                     angle = uniform(random, 0, 2 * kPi), heading = uniform(random, 0, 2 * kPi);
        const glm::dvec3 target = a.mean + r * (std::cos(angle) * a.scale.x * a.rotation[0] +
                                                std::sin(angle) * a.scale.y * a.rotation[1]);
        const double facing = std::exp(uniform(random, std::log(1e-3), std::log(1e-2)));
        const glm::dvec3 direction =
            std::cos(heading) * a.rotation[0] + std::sin(heading) * a.rotation[1] + facing * a.rotation[2];
        add_ray(c, target - uniform(random, 1, 5) * direction, direction);
    }
    return c;
}

TraversalCase make_degenerate_case() {
    const double nan = std::numeric_limits<double>::quiet_NaN(),
                 inf = std::numeric_limits<double>::infinity();
    const Surfel good = make_facing_surfel(5, 0.5, 0.5);
    std::vector<Surfel> surfels(16, good);
    for (std::size_t i = 0; i < surfels.size(); ++i) surfels[i].mean.x = 4.0 + 0.1 * double(i);
    surfels[0].mean.y = nan;
    surfels[1].mean.x = inf;
    surfels[3].mean.z = -inf;
    surfels[4].rotation = {0, 0, 0, 0};
    surfels[5].rotation.z = nan;
    surfels[6].log_scale.x = -inf;
    surfels[7].log_scale.y = -800;  // 1 / s overflows
    surfels[8].log_scale = {nan, nan};
    surfels[10].opacity_logit = nan;
    surfels[11].opacity_logit = logit(0.99 / 255.0);
    surfels[12].opacity_logit = -inf;
    surfels[13].opacity_logit = -1e4;
    // instances 1 and 2 have no valid surfel
    TraversalCase c{"degenerate", to_surfels(surfels), {{0, 16, {}}, {0, 2, {}}, {4, 5, {}}}, {}};
    Random random(9);
    for (int i = 0; i < 40; ++i) add_ray(c, {0, 0, 0}, {5, uniform(random, -1, 1), uniform(random, -1, 1)});
    add_ray(c, {0, 0, 0}, {1, 0, 0});
    return c;
}

TraversalCase make_random_case(std::uint64_t seed, int n_surfels, int n_rays) {
    Random random(seed);
    std::vector<Surfel> surfels;
    for (int i = 0; i < n_surfels; ++i)
        surfels.push_back(make_random_surfel(random, i < n_surfels * 3 / 4 ? 4.0 : 1.5));
    // exact copies, which have equal t
    for (int i = 0; i < n_surfels / 20; ++i)
        surfels[std::size_t(i)] = surfels[std::size_t(n_surfels / 2 + i)];
    TraversalCase c{"random", to_surfels(surfels), {}, {}};
    const auto n_background = std::uint32_t(n_surfels * 3 / 4),
               n_actor = std::uint32_t(n_surfels) - n_background;
    c.instances.push_back({0, n_background, {}});
    for (int i = 0; i < 3; ++i)
        c.instances.push_back({n_background,
                               n_actor,
                               {glm::angleAxis(uniform(random, 0, kPi), draw_unit_vector(random)),
                                draw_uniform_point(random, 2.0)}});
    for (int i = 0; i < n_rays; ++i) {
        const glm::dvec3 origin = draw_uniform_point(random, 5.0);
        add_ray(c, origin, draw_uniform_point(random, 3.0) - origin);
    }
    return c;
}

TraversalCase to_gaussians(TraversalCase test_case, std::uint64_t seed) {
    Random random(seed);
    constexpr float kNan = std::numeric_limits<float>::quiet_NaN(),
                    kInfinity = std::numeric_limits<float>::infinity();
    const float unusable[] = {kNan, -kInfinity, -800.0f};  // for the last value 1 / s overflows
    for (std::size_t i = 0; i < test_case.surfels.mean.size(); ++i) {
        const auto thickness = float(uniform(random, std::log(0.03), std::log(0.5)));
        test_case.surfels.log_scale_w.push_back(i % 20 == 19 ? unusable[i / 20 % 3] : thickness);
    }
    test_case.surfels.primitive = PrimitiveType::gaussian;
    test_case.name += " as 3D Gaussians";
    return test_case;
}

TraversalCase make_crowded_case(std::uint64_t seed, int n_gaussians, int n_rays) {
    Random random(seed);
    std::vector<Surfel> surfels;
    for (int i = 0; i < n_gaussians; ++i) {
        Surfel s = make_random_surfel(random, 4.0);
        s.log_scale += std::log(6.0);
        s.log_scale_w = uniform(random, std::log(0.2), std::log(3.0));
        if (i % 4 == 0) s.log_scale_w = uniform(random, std::log(1e-5), std::log(1e-3));
        if (i % 8 == 1) s.log_scale = glm::dvec2(uniform(random, std::log(1e-3), std::log(1e-2)));
        surfels.push_back(s);
    }
    TraversalCase c{"crowded 3D Gaussians", to_surfels(surfels), {}, {}};
    c.instances = {{0, std::uint32_t(n_gaussians), {}},
                   {0,
                    std::uint32_t(n_gaussians / 2),
                    {glm::angleAxis(0.8, draw_unit_vector(random)), {0.5, -0.3, 0.2}}}};
    for (int i = 0; i < n_rays; ++i) add_ray(c, draw_uniform_point(random, 5.0), draw_unit_vector(random));
    return c;
}

std::vector<TraversalCase> make_gaussian_cases(std::uint64_t seed, int n_rays) {
    std::vector<TraversalCase> cases;
    for (const TraversalCase& c : {make_single_case(), make_equal_depth_case(), make_degenerate_case(),
                                   make_outline_case(seed, n_rays), make_random_case(seed + 2, 400, n_rays)})
        cases.push_back(to_gaussians(c, seed + 3));
    cases.push_back(make_crowded_case(seed + 4, 120, n_rays));
    return cases;
}

TraversalCase make_moving_case(TraversalCase test_case, std::uint64_t seed) {
    Random random(seed);
    for (std::size_t i = 0; i < test_case.instances.size(); ++i) {
        if (i % 4 == 2) continue;
        reference::Motion& m = test_case.instances[i].motion;
        m.velocity = uniform(random, 5.0, 40.0) * draw_unit_vector(random);
        if (i % 2 == 1) m.angular_velocity = uniform(random, 0.5, 6.0) * draw_unit_vector(random);
        m.half_span_s = double(float(i % 3 == 0 ? 0.05 : uniform(random, 0.002, 0.03)));
        m.middle_s = double(float(i % 3 == 0 ? 0.0 : uniform(random, -0.03, 0.03)));
    }
    for (std::size_t i = 0; i < test_case.rays.size(); ++i)
        test_case.rays.time_s.push_back(float(uniform(random, -0.07, 0.07)));
    test_case.name += " that moves";
    return test_case;
}

std::vector<TraversalCase> make_moving_cases(std::uint64_t seed, int n_rays) {
    TraversalCase many = make_random_case(seed + 1, 200, n_rays);  // more surfels than a mask has bits
    Random random(seed);
    for (int i = 0; i < 12; ++i)
        many.instances.push_back({150,
                                  50,
                                  {glm::angleAxis(uniform(random, 0, kPi), draw_unit_vector(random)),
                                   draw_uniform_point(random, 3.0)}});
    return {make_moving_case(make_equal_depth_case(), seed),
            make_moving_case(make_random_case(seed, 800, n_rays), seed), make_moving_case(many, seed + 2),
            make_moving_case(to_gaussians(make_random_case(seed + 3, 400, n_rays), seed), seed),
            make_moving_case(make_crowded_case(seed + 4, 120, n_rays), seed)};
}

std::vector<TraversalCase> make_conformance_cases(std::uint64_t seed, int n_rays) {
    return {make_empty_case(),
            make_single_case(),
            make_equal_depth_case(),
            make_long_list_case(),
            make_degenerate_case(),
            make_outline_case(seed, n_rays),
            make_grazing_case(seed + 1, n_rays),
            make_random_case(seed + 2, 800, n_rays)};
}

}  // namespace relidar::test
