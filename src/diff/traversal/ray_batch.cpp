// SPDX-License-Identifier: Apache-2.0
#include <relidar/diff/traversal.hpp>

#include <algorithm>

namespace relidar {

std::vector<DeviceRay> to_device_rays(const WorldRays& rays) {
    std::vector<DeviceRay> result;
    for (std::size_t i = 0; i < rays.size(); ++i)
        result.push_back(
            {rays.origin[i], rays.direction[i], rays.time_s.empty() ? RELIDAR_NO_TIME : rays.time_s[i]});
    return result;
}

std::size_t count_threads(const RayBatch& batch) {
    if (batch.columns == 0) return batch.n_rays;
    const std::size_t rows = batch.n_rays / batch.columns;
    return (rows + 1) / 2 * ((std::size_t(batch.columns) + 15) / 16) * 32;
}

std::uint32_t grow_stored_hits(std::uint32_t hits_per_ray, std::uint64_t n_overflowed_rays) {
    constexpr std::uint32_t kMaxStoredHits = 256;
    return n_overflowed_rays > 0 ? std::max(hits_per_ray, std::min(2 * hits_per_ray, kMaxStoredHits))
                                 : hits_per_ray;
}

}  // namespace relidar
