// SPDX-License-Identifier: Apache-2.0
#include "diff/traversal/collect_hits.hpp"

#include "base/fail.hpp"
#include "gpu/stream.hpp"

namespace relidar {

CollectedHits collect_hits(Device& device, const KernelVariant& variant, const TraceConstants& constants,
                           shared::TraceScene scene, const WorldRays& rays, std::uint32_t max_hits) {
    const Kernel<shared::CollectHitsParams> kernel(device, "diff/traversal/collect_hits", variant, constants);
    const std::size_t n = rays.size(), n_slots = n * max_hits;
    const Array<DeviceRay> device_rays(device, to_device_rays(rays), "rays");
    const Array<std::uint32_t, shared::PassCapCount> pass_cap(device, std::vector<std::uint32_t>{0u},
                                                              "number of truncated rays");
    const Array<std::uint32_t, shared::HitCounts> counts(device, n, "hit counts");
    const Array<std::uint32_t, shared::HitInstances> instance(device, n_slots, "hit instances");
    const Array<std::uint32_t, shared::HitSurfels> surfel(device, n_slots, "hit surfels");
    const Array<float, shared::HitDistances> t(device, n_slots, "hit distances");
    scene.rays = device_rays.address();
    scene.pass_cap_count = pass_cap.address();
    scene.n_rays = std::uint32_t(n);
    Stream stream(device);
    run(stream, kernel, n,
        {.scene = scene,
         .counts = counts.address(),
         .t = t.address(),
         .instance = instance.address(),
         .surfel = surfel.address(),
         .max_hits = max_hits});
    stream.submit_and_wait();
    if (const std::uint32_t capped = pass_cap.download()[0])
        fail<DeviceError>("cannot collect the hits of {} rays: {} searches were truncated, expected none", n,
                          capped);
    return {max_hits, counts.download(), t.download(), instance.download(), surfel.download()};
}

}  // namespace relidar
