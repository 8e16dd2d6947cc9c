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
    const bool is_image = batch.columns > 0;
    if (!is_image) return batch.n_rays;
    // 32 neighbouring threads render a tile of an image.
    constexpr std::size_t kTileRows = 2, kTileColumns = 16;
    const std::size_t n_rows = batch.n_rays / batch.columns;
    const std::size_t n_tiles =
        (n_rows + kTileRows - 1) / kTileRows * ((batch.columns + kTileColumns - 1) / kTileColumns);
    return n_tiles * kTileRows * kTileColumns;
}

std::uint32_t grow_stored_hits(std::uint32_t hits_per_ray, std::uint64_t n_overflowed_rays) {
    constexpr std::uint32_t kMaxStoredHits = 256;
    return n_overflowed_rays > 0 ? std::max(hits_per_ray, std::min(2 * hits_per_ray, kMaxStoredHits))
                                 : hits_per_ray;
}

}  // namespace relidar
