// SPDX-License-Identifier: Apache-2.0
#include "simulate/render/seen.hpp"

#include "base/parallel.hpp"
#include "simulate/render/points_on_device.hpp"

namespace relidar {
namespace {

// A ray counts as observed if at least this share of its path was observed.
constexpr float kMinObservedFraction = 0.5f;

bool is_unobserved(float observed_fraction) { return observed_fraction < kMinObservedFraction; }

RayWithSurfaceRange surface_ray(const RenderedScan& scan, std::size_t ray) {
    return {scan.firing_pose(ray), glm::dvec3(scan.image.origin[ray]), glm::dvec3(scan.image.direction[ray]),
            scan.median_range_m[ray]};
}

/// Returns the fraction of a ray's path that the log has observed. The path ends at the
/// surface that the ray hits, or at the maximum range.
float observed_share(const RayWithSurfaceRange& ray, const LogObservedSpace& space) {
    Pose world_from_firing = ray.dataset_from_firing;
    world_from_firing.translation -= space.world_offset_m;
    const double length_m =
        ray.met_m > 0.0f ? std::min(double(ray.met_m), space.max_range_m) : space.max_range_m;
    return static_cast<float>(space.coverage.observed_fraction(
        world_from_firing * ray.origin_m, world_from_firing * (ray.origin_m + length_m * ray.direction)));
}

}  // namespace

double unobserved_share(std::size_t n_rays, const RaySource& get_ray, const LogObservedSpace& space) {
    std::vector<float> shares(n_rays);
    parallel_blocks(n_rays,
                    [&](std::size_t index) { shares[index] = observed_share(get_ray(index), space); });
    return double(std::ranges::count_if(shares, is_unobserved)) / double(n_rays);
}

std::vector<float> observed_shares(const RenderedScan& scan, const std::vector<std::size_t>& rays,
                                   const LogObservedSpace& space) {
    std::vector<float> shares(rays.size());
    parallel_blocks(rays.size(), [&](std::size_t index) {
        shares[index] = observed_share(surface_ray(scan, rays[index]), space);
    });
    return shares;
}

void set_unseen_share(RenderedScan& scan, const LogObservedSpace& space) {
    const std::size_t n = scan.median_range_m.size();
    if (space.coverage.empty() || n == 0) return;
    const auto ray_at = [&](std::size_t index) {
        return surface_ray(scan, DevicePointComputer::sample_ray(index, n));
    };
    // Without the channel `seen`, a sample of the rays gives an estimate.
    if (const std::vector<float>* shares = find_values<float>(scan.channels, "seen"))
        scan.unseen_share = double(std::ranges::count_if(*shares, is_unobserved)) / double(shares->size());
    else scan.unseen_share = unobserved_share(DevicePointComputer::sample_count(n), ray_at, space);
}

}  // namespace relidar
