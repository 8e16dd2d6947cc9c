// SPDX-License-Identifier: Apache-2.0
// Classifies the differences between the hits that two methods find (docs/architecture.md
// sections 6 and 9; boundaries of M1 and M2).
#include "hit_comparison.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <utility>

namespace relidar::test {
namespace {

using Id = std::pair<std::uint32_t, std::uint32_t>;

Id get_id(const reference::Hit& hit) { return {hit.instance, hit.surfel}; }

std::string describe(std::size_t ray_index, const char* description, const reference::Hit& hit) {
    char text[160];
    std::snprintf(text, sizeof text, "ray %zu: %s (instance %u, surfel %u) at t = %.9g", ray_index,
                  description, hit.instance, hit.surfel, hit.t);
    return text;
}

void add_error(HitDifferences& differences, const std::string& message) {
    if (differences.n_errors++ == 0) differences.first_error = message;
}

}  // namespace

bool is_on_boundary(const reference::World& world, const ImageModel& model, const reference::Ray& ray,
                    const reference::Hit& hit) {
    const reference::DoubleRecord r = reference::make_record(world.surfels[hit.surfel]);
    const auto local = reference::to_model(world.instances[hit.instance].at(ray.time_s), ray);
    const reference::PlaneHit<double> met = reference::meet(r, local);
    const glm::dvec3 uvw(met.u, met.v, met.w),
        along(glm::dot(r.axis_u, local.direction), glm::dot(r.axis_v, local.direction),
              glm::dot(r.normal, local.direction));
    const double t = met.t, size_m = glm::length(ray.origin) + glm::length(r.mean) +
                                     glm::length(r.mean - local.origin) + std::abs(t);
    // position error in standard deviations
    const double of_axes =
        4e-7 * size_m * (glm::length(r.axis_u) + glm::length(r.axis_v) + glm::length(r.normal));
    const bool is_flat = r.primitive == PrimitiveType::surfel;
    const double t_error = is_flat ? 4e-7 * size_m / std::abs(along.z) : of_axes / glm::length(along);
    const double log_alpha = std::log(r.sigma) - 0.5 * glm::dot(uvw, uvw);
    // A Gaussian has its maximum along the ray at t. A small error of t therefore does
    // not change its density to first order.
    const double uvw_error = of_axes + (is_flat ? glm::length(glm::dvec2(along)) * t_error : 0.0);
    // true for NaN
    const bool at_cut = !(std::abs(log_alpha - std::log(double(model.alpha_min))) >
                          1e-5 + (glm::length(uvw) + (is_flat ? 0.0 : uvw_error)) * uvw_error);
    const bool at_near_limit = !(std::abs(t - double(model.near_m)) > t_error);
    return at_cut || at_near_limit;
}

void compare_hits(const reference::World& world, const ImageModel& model, const reference::Ray& ray,
                  std::size_t ray_index, const std::vector<reference::Hit>& expected,
                  const std::vector<reference::Hit>& actual, HitDifferences& differences) {
    differences.n_rays += 1;
    differences.n_hits += expected.size();
    const auto same_id = [](const reference::Hit& first, const reference::Hit& second) {
        return get_id(first) == get_id(second);
    };
    if (std::equal(expected.begin(), expected.end(), actual.begin(), actual.end(), same_id)) return;
    differences.n_different_rays += 1;
    std::map<Id, double> expected_t;
    std::map<Id, int> report_counts;
    for (const reference::Hit& hit : expected) expected_t[get_id(hit)] = hit.t;
    double last_t = -HUGE_VAL;
    for (const reference::Hit& hit : actual) {
        if (++report_counts[get_id(hit)] > 1)
            add_error(differences, describe(ray_index, "reported twice:", hit));
        const auto match = expected_t.find(get_id(hit));
        if (match == expected_t.end()) {
            if (is_on_boundary(world, model, ray, hit)) differences.n_flips += 1;
            else add_error(differences, describe(ray_index, "not a hit:", hit));
            continue;
        }
        if (match->second < last_t) {
            if (last_t - match->second <= 1e-5 * (1.0 + std::abs(last_t))) differences.n_swaps += 1;
            else add_error(differences, describe(ray_index, "out of order:", hit));
        }
        last_t = std::max(last_t, match->second);
    }
    for (const reference::Hit& hit : expected) {
        if (report_counts.contains(get_id(hit))) continue;
        if (is_on_boundary(world, model, ray, hit)) differences.n_flips += 1;
        else add_error(differences, describe(ray_index, "missed:", hit));
    }
}

std::string HitDifferences::summary(const std::string& title) const {
    char text[240];
    std::snprintf(text, sizeof text,
                  "%-14s %7zu rays %9zu hits %6zu different: %5zu flips %4zu swaps %4zu errors",
                  title.c_str(), n_rays, n_hits, n_different_rays, n_flips, n_swaps, n_errors);
    return text + (first_error.empty() ? std::string() : "; first: " + first_error);
}

}  // namespace relidar::test
