// SPDX-License-Identifier: Apache-2.0
// Submits the kernel diff/traversal/collect_hits, which writes all hits of each ray from
// near to far, and downloads the hits.
#include "diff/traversal/collect_hits.hpp"

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "diff/traversal/trace_scene.hpp"
#include "gpu/stream.hpp"

namespace relidar {

CollectedHits collect_hits(Device& device, const PlacedScene& placed, const WorldRays& rays,
                           std::uint32_t max_hits) {
    Stream stream(device);
    DeviceScene on_device(device, *placed.scene);
    on_device.set_poses(placed.world_from_instance);
    Accel accel(device, on_device, placed.accel);
    const Kernel<shared::CollectHitsParams> kernel(
        device, "diff/traversal/collect_hits", get_traversal_variant(device),
        make_trace_constants(device, accel.proxy(), placed.trace, placed.model));
    const std::size_t n = rays.size();
    const Array<DeviceRay> device_rays(device, std::span<const DeviceRay>(to_device_rays(rays)), "rays");
    const Array<std::uint32_t, shared::PassCapCount> pass_cap(device, std::vector<std::uint32_t>{0u},
                                                              "pass cap count");
    const Array<std::uint32_t, shared::HitCounts> counts(device, n, "hit counts");
    const Array<std::uint32_t, shared::HitInstances> instance(device, n * max_hits, "hit instances");
    const Array<std::uint32_t, shared::HitSurfels> surfel(device, n * max_hits, "hit surfels");
    const Array<float, shared::HitDistances> t(device, n * max_hits, "hit distances");
    on_device.activate(stream, placed.model, glm::vec3(0.0f));
    accel.update(stream, on_device);
    run(stream, kernel, n,
        {.scene = make_trace_scene(on_device, accel, {&device_rays, 0, 1, static_cast<std::uint32_t>(n)},
                                   placed.model, placed.trace, pass_cap.address()),
         .counts = counts.address(),
         .t = t.address(),
         .instance = instance.address(),
         .surfel = surfel.address(),
         .max_hits = max_hits});
    stream.finish();
    if (const std::uint32_t capped = pass_cap.download()[0])
        throw DeviceError(
            fmt::format("cannot collect the hits of {} rays: {} of them exceeded the maximum of {} traversal "
                        "passes or the traversal stack",
                        n, capped, RELIDAR_MAX_PASSES));
    return {max_hits, counts.download(), t.download(), instance.download(), surfel.download()};
}

}  // namespace relidar
