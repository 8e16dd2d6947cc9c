// SPDX-License-Identifier: Apache-2.0
#include "diff/traversal/collect_hits.hpp"

#include <algorithm>

#include "base/fail.hpp"
#include "gpu/stream.hpp"

namespace relidar {

std::vector<std::vector<shared::Hit>> collect_hits(Device& device, const KernelVariant& variant,
                                                   const TraceConstants& constants, shared::TraceScene scene,
                                                   const WorldRays& rays, std::uint32_t max_hits) {
    const Kernel<shared::CollectHitsParams> kernel(device, "diff/traversal/collect_hits", variant, constants);
    const std::size_t n_rays = rays.size();
    const Array<DeviceRay> device_rays(device, to_device_rays(rays), "rays");
    const Array<std::uint32_t, shared::PassCapCount> n_truncated(device, std::vector<std::uint32_t>{0u},
                                                                 "number of truncated rays");
    const Array<std::uint32_t, shared::HitCounts> counts(device, n_rays, "hit counts");
    const Array<shared::Hit> slots(device, n_rays * max_hits, "hits");  // one row per ray
    scene.rays = device_rays.address();
    scene.pass_cap_count = n_truncated.address();
    scene.n_rays = std::uint32_t(n_rays);
    Stream stream(device);
    run(stream, kernel, n_rays,
        {.scene = scene, .counts = counts.address(), .hits = slots.address(), .max_hits = max_hits});
    stream.submit_and_wait();
    // A search ends early if it needs too many passes. A pass finds the next few hits.
    const std::uint32_t n_incomplete = n_truncated.download()[0];
    if (n_incomplete > 0)
        fail<DeviceError>("cannot collect the hits of {} rays: {} searches were truncated, expected none",
                          n_rays, n_incomplete);
    std::vector<std::vector<shared::Hit>> hits;
    const std::vector<shared::Hit> all = slots.download();
    auto row = all.begin();
    for (const std::uint32_t count : counts.download()) {
        hits.emplace_back(row, row + std::min(count, max_hits));
        row += max_hits;
    }
    return hits;
}

}  // namespace relidar
