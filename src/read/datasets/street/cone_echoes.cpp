// SPDX-License-Identifier: Apache-2.0
// Reference for tests of the renderer: computes the returns of a conical beam. Casts rays
// inside the cone along a golden-angle spiral, and separates returns by sorting the hits.
// Tests compare src/simulate/render/footprint.cpp with this code, which is independent
// and samples the cone in other directions.
#include "read/datasets/street/cone_echoes.hpp"

#include <algorithm>
#include <cmath>

namespace relidar::street {
namespace {

constexpr double kGoldenAngle_rad = 2.399963229728653;
// A second return needs at least this distance and this share of the light. The minimum
// intensity prevents a division by zero for black surfaces.
constexpr float kMinSeparation_m = 0.5f, kMinSecondShare = 0.1f, kMinIntensity = 1e-3f;

struct SubRayHit {
    float range_m = 0.0f, light = 0.0f;
};

/// Combines the hits of the thin rays of a beam to returns, sorted by range.
/// @param n_hits  output: thin rays that hit a surface
std::vector<SubRayHit> group_hits(const Scan& cone_scan, std::size_t ray, int& n_hits) {
    std::vector<std::pair<float, float>> hits;
    for (std::size_t i = ray * kConeRays; i < (ray + 1) * kConeRays; ++i)
        if (cone_scan.range_m[i] > 0.0f)
            hits.emplace_back(cone_scan.range_m[i], std::max(cone_scan.intensity[i], kMinIntensity));
    n_hits = int(hits.size());
    std::sort(hits.begin(), hits.end());
    std::vector<SubRayHit> returns;
    float last_m = -1e9f;
    for (const auto& [range_m, light] : hits) {
        if (range_m - last_m >= kMinSeparation_m) returns.emplace_back();
        returns.back().range_m += range_m * light;
        returns.back().light += light;
        last_m = range_m;
    }
    for (SubRayHit& r : returns) r.range_m /= r.light;
    return returns;
}

/// Chooses the second return of a beam: the last one, or the next strongest one if the
/// strongest return is the last. Returns an empty hit if it is too weak.
SubRayHit choose_second(const std::vector<SubRayHit>& returns,
                        std::vector<SubRayHit>::const_iterator strongest_return) {
    SubRayHit second;
    if (strongest_return + 1 != returns.end()) {
        second = returns.back();
    } else {
        for (auto r = returns.begin(); r != returns.end(); ++r)
            if (r != strongest_return && r->light > second.light) second = *r;
    }
    return second.light >= kMinSecondShare * strongest_return->light ? second : SubRayHit{};
}

}  // namespace

RayTable make_cone_rays(const RayTable& rays) {
    RayTable cone;
    cone.rows = rays.rows;
    cone.columns = rays.columns * kConeRays;
    for (std::size_t i = 0; i < rays.size(); ++i) {
        // d, side and d x side are orthogonal. The helper axis is never parallel to d.
        const glm::dvec3 d(rays.direction[i]),
            side = glm::normalize(
                glm::cross(d, std::abs(d.z) < 0.9 ? glm::dvec3(0, 0, 1) : glm::dvec3(1, 0, 0)));
        for (int k = 0; k < kConeRays; ++k) {
            // The square root spreads the rays evenly over the area of the cone.
            const double angle = 0.5 * rays.divergence_of_rad(i) * std::sqrt((k + 0.5) / kConeRays);
            // Direction from the beam axis to thin ray k. Steps of the golden angle
            // spread the rays evenly around the axis.
            const glm::dvec3 off = std::cos(1.0 + k * kGoldenAngle_rad) * side +
                                   std::sin(1.0 + k * kGoldenAngle_rad) * glm::cross(d, side);
            cone.direction.emplace_back(std::cos(angle) * d + std::sin(angle) * off);
            cone.origin.push_back(rays.origin[i]);
            cone.time_offset_s.push_back(rays.time_offset_s[i]);
            cone.channel.push_back(rays.channel[i]);
        }
    }
    return cone;
}

Scan combine_cone(const RayTable& rays, const Scan& scan_of_cone_rays) {
    Scan scan{rays, ScanArray<float>(rays.size()), ScanArray<float>(rays.size()), {}};
    AdditionalReturns& echo = scan.second_returns.emplace_back(
        AdditionalReturns{std::vector<float>(rays.size()), std::vector<float>(rays.size())});
    for (std::size_t i = 0; i < rays.size(); ++i) {
        int n_back = 0;
        const std::vector<SubRayHit> returns = group_hits(scan_of_cone_rays, i, n_back);
        // A beam has a return only if more than half of its thin rays hit a surface.
        if (2 * n_back <= kConeRays) continue;
        const auto strongest = std::ranges::max_element(returns, {}, &SubRayHit::light);
        const SubRayHit second = choose_second(returns, strongest);
        scan.range_m[i] = strongest->range_m;
        // mean light of all thin rays of the beam
        scan.intensity[i] = std::min(strongest->light / kConeRays, 1.0f);
        echo.range_m[i] = second.range_m;
        echo.intensity[i] = second.light / kConeRays;
    }
    return scan;
}

}  // namespace relidar::street
