// SPDX-License-Identifier: Apache-2.0
// The host side of shaders/traversal: fills the part of the parameters that all tracing kernels share, names their variants.
// Infrastructure of forward and backward alike, so neither reaches into the other.
#pragma once

#include <relidar/traversal.hpp>

#include "gpu/kernel.hpp"
#include "shared/trace.h"

namespace relidar {

inline shared::TraceScene trace_scene(const DeviceScene& scene, const Accel& accel, const RayBatch& batch, const ImageModel& model, std::uint64_t pass_cap_address) {
    return {accel.tlas_address(), {}, batch.rays->address(), scene.records().address(), scene.instances_address(), scene.parameters().sh.address(), pass_cap_address, 0,
            model.near_m, model.alpha_min, model.alpha_max, model.transmittance_min, static_cast<std::uint32_t>(scene.layout().instances.size()),
            static_cast<std::uint32_t>(model.sh_degree), batch.n_rays, batch.first, batch.stride};
}

inline std::string traversal_variant(const TraceOptions& options) { return options.brute_force ? "@brute_force" : "@ray_query"; }

}  // namespace relidar
