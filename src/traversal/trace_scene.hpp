// SPDX-License-Identifier: Apache-2.0
// The host side of shaders/traversal: fills the part of the parameters that all tracing kernels share, names their variants.
// Infrastructure of forward and backward alike, so neither reaches into the other.
#pragma once

#include <relidar/stages/accel.hpp>
#include <relidar/stages/scene.hpp>
#include <relidar/stages/traversal.hpp>

#include "gpu/kernel.hpp"
#include "shared/trace.h"

namespace relidar {

/// Threads that trace a batch: whole tiles of 8 x 4 rays over an image, some of them beside it; else one a ray.
inline std::size_t trace_threads(const RayBatch& batch) {
    if (batch.columns == 0) return batch.n_rays;
    const std::size_t rows = batch.n_rays / batch.columns;
    return (rows + 3) / 4 * ((std::size_t(batch.columns) + 7) / 8) * 32;
}

inline shared::TraceScene trace_scene(const DeviceScene& scene, const Accel& accel, const RayBatch& batch, const ImageModel& model, std::uint64_t pass_cap_address) {
    const AccelAddresses a = accel.addresses();
    return {a.tlas, a.reach, {a.nodes, a.order, a.roots, a.top_nodes, a.top_order}, batch.rays->address(), scene.records().address(), scene.instances_address(),
            scene.parameters().sh.address(), pass_cap_address, 0,
            model.near_m, model.alpha_min, model.alpha_max, model.transmittance_min, static_cast<std::uint32_t>(scene.layout().instances.size()),
            static_cast<std::uint32_t>(model.sh_degree), batch.n_rays, batch.first, batch.stride, batch.columns};
}

/// Which build of a tracing kernel a device runs.
inline std::string traversal_variant(const Device& device, const TraceOptions& options) {
    if (options.brute_force) return "@brute_force";
    return device.traversal() == Traversal::software ? "@software_bvh" : "@ray_query";
}

/// Whether rays of a subgroup walk the software tree together. Measured: 1.2 times as fast on lavapipe (docs/platform.md); on a GPU lanes are free to part.
inline bool walks_together(const Device& device, const TraceOptions& options) {
    return options.walk == Walk::automatic ? device.info().type == "CPU" : options.walk == Walk::subgroup;
}

/// Specialisation constants of the tracing kernels (shaders/traversal).
inline std::vector<Constant> trace_constants(const Device& device, Proxy proxy, const TraceOptions& options, const ImageModel& model) {
    return {{1u, static_cast<std::uint32_t>(options.chunk)}, {2u, proxy == Proxy::boxes ? 1u : 0u}, {3u, model.sh_direction == ShDirection::surfel ? 1u : 0u},
            {4u, walks_together(device, options) ? 1u : 0u}, {8u, model.single_drop_logit ? 1u : 0u},
            {9u, model.primitive == Primitive::gaussian ? 1u : 0u}, {10u, options.geometry ? 1u : 0u}};
}

}  // namespace relidar
