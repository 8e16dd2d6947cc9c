// SPDX-License-Identifier: Apache-2.0
#include "simulate/render/seen.hpp"

#include <algorithm>

#include "base/parallel.hpp"
#include "simulate/render/points_on_device.hpp"

namespace relidar {
namespace {

// A ray counts as observed by the log if at least this share of its path lies in observed
// space.
constexpr float kSeen = 0.5f;

bool is_mostly_unseen(float share) { return share < kSeen; }

LookingRay make_visibility_ray(const RenderedScan& scan, std::size_t index) {
    return {scan.get_firing_pose(index), glm::dvec3(scan.image.origin[index]),
            glm::dvec3(scan.image.direction[index]), scan.median_range_m[index]};
}

/// Returns the share of a ray's path that lies in space observed by the log. The path
/// ends at the surface that the ray hits, or at the maximum range.
float compute_seen_share(const LookingRay& ray, const SeenByLog& log) {
    Pose world_from_firing = ray.dataset_from_firing;
    world_from_firing.translation -= log.world_offset_m;
    const double length_m = ray.met_m > 0.0f ? std::min(double(ray.met_m), log.max_range_m) : log.max_range_m;
    return static_cast<float>(log.coverage.share(
        world_from_firing * ray.origin_m, world_from_firing * (ray.origin_m + length_m * ray.direction)));
}

}  // namespace

double compute_unseen_share(std::size_t count, const std::function<LookingRay(std::size_t)>& ray_at,
                            const SeenByLog& log) {
    std::vector<float> shares(count);
    for_each_block(count, [&](std::size_t index) { shares[index] = compute_seen_share(ray_at(index), log); });
    return double(std::ranges::count_if(shares, is_mostly_unseen)) / double(count);
}

std::vector<float> compute_seen_shares(const RenderedScan& scan, const std::vector<std::size_t>& rays,
                                       const SeenByLog& log) {
    std::vector<float> shares(rays.size());
    for_each_block(rays.size(), [&](std::size_t index) {
        shares[index] = compute_seen_share(make_visibility_ray(scan, rays[index]), log);
    });
    return shares;
}

void set_unseen_share(RenderedScan& scan, const SeenByLog& log) {
    const std::size_t n = scan.median_range_m.size();
    if (log.coverage.empty() || n == 0) return;
    const auto ray_at = [&](std::size_t index) {
        return make_visibility_ray(scan, PointsOnDevice::get_sampled_ray(index, n));
    };
    if (const std::vector<float>* shares = find_values<float>(scan.channels, "seen"))
        scan.unseen_share = double(std::ranges::count_if(*shares, is_mostly_unseen)) / double(shares->size());
    else scan.unseen_share = compute_unseen_share(PointsOnDevice::n_requested(n), ray_at, log);
}

}  // namespace relidar
