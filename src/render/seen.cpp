// SPDX-License-Identifier: Apache-2.0
#include "render/seen.hpp"

#include <algorithm>

#include "core/parallel.hpp"

namespace relidar {
namespace {

constexpr std::size_t kAskedRays = 4096;  // a share of rays is then known to a percent, in milliseconds
constexpr float kSeen = 0.5f;             // of a ray's way

}  // namespace

std::vector<float> seen_shares(const RenderedScan& scan, const std::vector<std::size_t>& rays, const SeenByLog& log) {
    std::vector<float> shares(rays.size());
    for_each_block(rays.size(), [&](std::size_t k) {
        const std::size_t ray = rays[k];
        Pose world_from_firing = scan.world_from_firing(ray);
        world_from_firing.translation -= log.world_offset_m;
        const float met_m = scan.median_range_m[ray];
        const double length_m = met_m > 0.0f ? std::min(double(met_m), log.max_range_m) : log.max_range_m;
        const glm::dvec3 origin_m(scan.image.origin[ray]), end_m = origin_m + length_m * glm::dvec3(scan.image.direction[ray]);
        shares[k] = static_cast<float>(log.coverage.share(world_from_firing * origin_m, world_from_firing * end_m));
    });
    return shares;
}

void tell_unseen(RenderedScan& scan, const SeenByLog& log) {
    const std::size_t n = scan.median_range_m.size(), n_asked = std::min(n, kAskedRays);
    if (log.coverage.empty() || n == 0) return;
    std::vector<float> some;
    const std::vector<float>* shares = find_values<float>(scan.channels, "seen");
    if (!shares) {
        std::vector<std::size_t> rays;
        for (std::size_t k = 0; k < n_asked; ++k) rays.push_back(k * n / n_asked);
        some = seen_shares(scan, rays, log);
        shares = &some;
    }
    scan.unseen_share = double(std::ranges::count_if(*shares, [](float share) { return share < kSeen; })) / double(shares->size());
}

}  // namespace relidar
