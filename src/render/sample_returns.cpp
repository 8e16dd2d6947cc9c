// SPDX-License-Identifier: Apache-2.0
// One scan drawn from the likely ones.
#include <algorithm>
#include <bit>
#include <cmath>

#include <relidar/render.hpp>

#include "core/random.hpp"

namespace relidar {
namespace {

float surface_range(const RenderedScan& scan, std::size_t i) { return scan.median_range_m[i] > 0.0f ? scan.median_range_m[i] : scan.image.range_m[i]; }

glm::dvec3 point(const RenderedScan& scan, std::size_t i) { return glm::dvec3(scan.image.origin[i]) + double(surface_range(scan, i)) * glm::dvec3(scan.image.direction[i]); }

/// Cosine of the angle of incidence, from the pixels beside and below; 1 where they are none or lie on another surface.
double incidence_cosine(const RenderedScan& scan, std::size_t i) {
    constexpr double kSameSurface = 0.2;   // of the range
    const auto columns = std::size_t(scan.image.columns), row = i / columns, column = i % columns;
    if (scan.image.rows < 2 || columns < 3) return 1.0;
    const std::size_t beside = row * columns + (column + 1) % columns, below = row + 1 < std::size_t(scan.image.rows) ? i + columns : i - columns;
    const double range_m = surface_range(scan, i);
    for (const std::size_t k : {beside, below})
        if (!(surface_range(scan, k) > 0.0f) || std::abs(double(surface_range(scan, k)) - range_m) > kSameSurface * range_m) return 1.0;
    const glm::dvec3 normal = glm::cross(point(scan, beside) - point(scan, i), point(scan, below) - point(scan, i));
    const double length = glm::length(normal);
    return length > 0.0 ? std::abs(glm::dot(normal / length, glm::dvec3(scan.image.direction[i]))) : 1.0;
}

}  // namespace

void sample_returns(RenderedScan& scan, const RangeNoise& noise, std::uint64_t seed) {
    const std::uint64_t of_scan = hash64(seed, std::bit_cast<std::uint64_t>(scan.time_s));
    std::vector<float> ranges_m(scan.image.range_m.size());
    for (std::size_t i = 0; i < ranges_m.size(); ++i) {   // neighbours are still without noise
        Random random(hash64(of_scan, i));
        const float range_m = surface_range(scan, i);
        const bool returns = range_m > 0.0f && random.uniform() >= double(scan.image.drop_prob[i]);
        scan.image.drop_prob[i] = returns ? 0.0f : 1.0f;
        const double sigma_m = noise.at(double(range_m), incidence_cosine(scan, i));
        ranges_m[i] = returns ? std::max(range_m + static_cast<float>(sigma_m * random.normal()), 1e-3f) : range_m;
    }
    scan.image.range_m = ranges_m;
    scan.median_range_m = std::move(ranges_m);
}

}  // namespace relidar
