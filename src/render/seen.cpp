// SPDX-License-Identifier: Apache-2.0
#include "render/seen.hpp"

#include <algorithm>

#include "core/parallel.hpp"

namespace relidar {
namespace {

constexpr std::size_t kAskedRays = 4096;   // a share of rays is then known to a percent, in milliseconds
constexpr float kSeen = 0.5f;              // of a ray's way

}  // namespace

std::vector<float> seen_shares(const RenderedScan& scan, const std::vector<std::size_t>& rays, const Coverage& coverage,
                               const glm::dvec3& world_offset_m, double max_range_m) {
    std::vector<float> shares(rays.size());
    for_each_block(rays.size(), [&](std::size_t k) {
        const std::size_t ray = rays[k];
        Pose world_from_firing = scan.world_from_firing(ray);
        world_from_firing.translation -= world_offset_m;
        const float met_m = scan.median_range_m[ray];
        const double length_m = met_m > 0.0f ? std::min(double(met_m), max_range_m) : max_range_m;
        const glm::dvec3 origin_m(scan.image.origin[ray]), end_m = origin_m + length_m * glm::dvec3(scan.image.direction[ray]);
        shares[k] = static_cast<float>(coverage.share(world_from_firing * origin_m, world_from_firing * end_m));
    });
    return shares;
}

void tell_seen(RenderedScan& scan, const Coverage& coverage, const glm::dvec3& world_offset_m, double max_range_m, bool per_ray) {
    const std::size_t n = scan.median_range_m.size();
    if (coverage.empty() || n == 0) return;
    std::vector<std::size_t> rays;
    const std::size_t n_asked = per_ray ? n : std::min(n, kAskedRays);
    for (std::size_t k = 0; k < n_asked; ++k) rays.push_back(k * n / n_asked);
    std::vector<float> shares = seen_shares(scan, rays, coverage, world_offset_m, max_range_m);
    scan.unseen_share = double(std::ranges::count_if(shares, [](float share) { return share < kSeen; })) / double(shares.size());
    if (per_ray) scan.seen = std::move(shares);
}

}  // namespace relidar
