// SPDX-License-Identifier: Apache-2.0
#include "densify.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace relidar::reference {

glm::dvec2 normal_pair(std::uint32_t key, std::uint32_t item, std::uint32_t draw) {
    std::array<std::uint32_t, 4> v{key, item, draw, 0};
    for (std::uint32_t& x : v) x = x * 1664525u + 1013904223u;
    const auto mix = [&] {
        v[0] += v[1] * v[3];
        v[1] += v[2] * v[0];
        v[2] += v[0] * v[1];
        v[3] += v[1] * v[2];
    };
    mix();
    for (std::uint32_t& x : v) x ^= x >> 16;
    mix();
    const double radius = std::sqrt(-2.0 * std::log(((v[0] >> 8) + 1.0) / 16777216.0)),
                 angle = 2.0 * 3.14159265358979323846 * double(v[1] >> 8) / 16777216.0;
    return {radius * std::cos(angle), radius * std::sin(angle)};
}

glm::dvec3 sample_point(const DensifiedSurfel& surfel, const glm::dvec2& z, double z_w) {
    const glm::dvec4 q = surfel.rotation / glm::length(surfel.rotation);
    const double w = q.x, x = q.y, y = q.z, k = q.w;
    const glm::dvec3 a_u(w * w + x * x - y * y - k * k, 2.0 * (x * y + w * k), 2.0 * (x * k - w * y));
    const glm::dvec3 a_v(2.0 * (x * y - w * k), w * w - x * x + y * y - k * k, 2.0 * (y * k + w * x));
    return surfel.mean + z.x * surfel.scale.x * a_u + z.y * surfel.scale.y * a_v +
           z_w * surfel.scale_w.value_or(0.0) * glm::cross(a_u, a_v);
}

Fate decide_fate(const DensifiedSurfel& surfel, double mean_gradient, const DensifyRules& rules,
                 std::uint32_t item) {
    if (!surfel.finite) return Fate::invalid;
    if (surfel.opacity < rules.min_opacity) return Fate::faint;
    const bool grows = mean_gradient > rules.gradient_threshold;
    const double largest = std::max({surfel.scale.x, surfel.scale.y, surfel.scale_w.value_or(0.0)});
    const bool splits = grows && largest >= rules.clone_scale;
    if ((splits ? largest / 1.6 : largest) > rules.max_scale) return Fate::large;
    if (rules.half_size.x > 0.0) {
        bool outside[2];
        for (std::uint32_t draw = 0; draw < 2; ++draw) {
            const glm::dvec3 p = glm::abs(sample_point(surfel, normal_pair(rules.key, item, draw),
                                                       normal_pair(rules.key, item, 4 + draw).x));
            outside[draw] = p.x > rules.half_size.x || p.y > rules.half_size.y || p.z > rules.half_size.z;
        }
        if (outside[0] && outside[1]) return Fate::outside;
    }
    if (splits) return Fate::split;
    return grows ? Fate::clone : Fate::keep;
}

std::vector<std::uint32_t> count_copies(const std::vector<std::uint32_t>& weight, std::uint32_t n_new,
                                        std::uint32_t phase) {
    std::vector<std::uint64_t> cumulative;
    std::uint64_t total = 0;
    for (const std::uint32_t w : weight) cumulative.push_back(total += w);
    std::vector<std::uint32_t> copies(weight.size(), 0);
    for (std::uint64_t j = 0; j < n_new; ++j) {
        const auto owner = std::find_if(cumulative.begin(), cumulative.end(), [&](std::uint64_t c) {
            return c * n_new + phase >= (j + 1) * total;
        });
        ++copies.at(std::size_t(owner - cumulative.begin()));
    }
    return copies;
}

}  // namespace relidar::reference
