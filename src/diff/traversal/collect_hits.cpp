// SPDX-License-Identifier: Apache-2.0
#include "diff/traversal/collect_hits.hpp"

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/fail.hpp"
#include "diff/traversal/trace_scene.hpp"
#include "gpu/stream.hpp"

namespace relidar {

CollectedHits collect_ray_hits(Device& device, const PosedScene& posed_scene, const WorldRays& rays,
                               std::uint32_t max_hits_per_ray) {
    Stream stream(device);
    DeviceScene on_device(device, *posed_scene.scene);
    on_device.upload_instance_poses_and_wait(posed_scene.world_from_instance);
    AccelerationStructure accel(device, on_device, posed_scene.accel);
    const Kernel<shared::CollectHitsParams> kernel(
        device, "diff/traversal/collect_hits", get_traversal_kernel_variant(device),
        make_trace_kernel_constants(device, accel.get_proxy_shape_of_surfels(), posed_scene.trace,
                                    posed_scene.model));
    const std::size_t n = rays.size();
    const Array<DeviceRay> device_rays(device, std::span<const DeviceRay>(to_device_rays(rays)), "rays");
    const Array<std::uint32_t, shared::PassCapCount> pass_cap(device, std::vector<std::uint32_t>{0u},
                                                              "number of truncated rays");
    const Array<std::uint32_t, shared::HitCounts> counts(device, n, "hit counts");
    const Array<std::uint32_t, shared::HitInstances> instance(device, n * max_hits_per_ray, "hit instances");
    const Array<std::uint32_t, shared::HitSurfels> surfel(device, n * max_hits_per_ray, "hit surfels");
    const Array<float, shared::HitDistances> t(device, n * max_hits_per_ray, "hit distances");
    on_device.record_activation_of_surfel_parameters(stream, posed_scene.model, glm::vec3(0.0f));
    accel.record_bvh_refit_or_build(stream, on_device);
    run(stream, kernel, n,
        {.scene =
             make_trace_scene_params(on_device, accel, {&device_rays, 0, 1, static_cast<std::uint32_t>(n)},
                                     posed_scene.model, posed_scene.trace, pass_cap.address()),
         .counts = counts.address(),
         .t = t.address(),
         .instance = instance.address(),
         .surfel = surfel.address(),
         .max_hits = max_hits_per_ray});
    stream.submit_and_wait();
    if (const std::uint32_t capped = pass_cap.download()[0])
        fail<DeviceError>(
            "cannot collect the hits of {} rays: too many surfels overlap, so that the search stopped {} "
            "times at its limit of {} passes or at a full stack; use a scene with smaller or fewer surfels",
            n, capped, RELIDAR_MAX_PASSES);
    return {max_hits_per_ray, counts.download(), t.download(), instance.download(), surfel.download()};
}

}  // namespace relidar
