// SPDX-License-Identifier: Apache-2.0
// Fills the parameters that all tracing kernels share, and selects kernel variants. Used
// by the forward and the backward pass.
#pragma once

#include <relidar/diff/accel.hpp>
#include <relidar/diff/traversal.hpp>
#include <relidar/scene/device_scene.hpp>

#include "diff/shared/trace.h"
#include "gpu/kernel.hpp"

namespace relidar {

/// Specialisation constants of a tracing kernel.
using TraceConstants = std::vector<SpecialisationConstant>;

/// Returns the parameters that tracing kernels need for a scene, except the rays. The
/// caller must add the rays.
inline shared::TraceScene trace_params(const DeviceScene& s, const AccelAddresses& a, const ImageModel& m) {
    shared::TraceScene t{};
    t.tlas = a.tlas;
    t.proxy_reach = a.proxy_reach;
    t.moving = a.moving;
    t.model_radii = a.model_radii;
    t.bvh = a.bvh;
    t.records = s.surfel_records().address();
    t.instances = s.instance_table().address();
    t.sh = s.surfel_parameters().sh.address();
    t.near_m = m.near_m;
    t.alpha_min = m.alpha_min;
    t.alpha_max = m.alpha_max;
    t.transmittance_min = m.transmittance_min;
    t.likelihood_scale_m = 1.0f;
    t.n_instances = std::uint32_t(s.layout().instances.size());
    t.n_moving = a.n_moving;
    t.sh_degree = std::uint32_t(m.sh_degree);
    t.ray_stride = 1;
    return t;
}

inline shared::TraceScene trace_params(const DeviceScene& scene, const AccelerationStructure& accel,
                                       const RayBatch& batch, const ImageModel& model,
                                       const TraceOptions& options,
                                       Address<std::uint32_t, shared::PassCapCount> pass_cap_count) {
    shared::TraceScene traced = trace_params(scene, accel.addresses(), model);
    traced.rays = batch.rays->address();
    traced.pass_cap_count = pass_cap_count;
    traced.n_rays = batch.n_rays;
    traced.first_ray = batch.first;
    traced.ray_stride = batch.stride;
    traced.columns = batch.columns;
    if (options.likelihood) {
        traced.targets = address_or_null(batch.targets);
        traced.likelihood_scale_m = options.likelihood->scale_m;
    }
    return traced;
}

inline KernelVariant kernel_variant(const Device& device) {
    if (is_brute_force(device)) return KernelVariant("@brute_force");
    return KernelVariant(device.backend() == RayTracingBackend::software ? "@software_bvh" : "@ray_query");
}

/// Returns the specialisation constant TOGETHER. 0: each ray traverses the tree
/// separately (default on GPUs). 1: the rays of a subgroup traverse the tree together. 2
/// (CPU only): these rays also load each surfel together.
inline std::uint32_t together_mode(const Device& device, const TraceOptions& options) {
    const bool is_cpu = device.info().type == "CPU";
    if (options.traversal_mode == BvhTraversalMode::automatic
            ? !is_cpu
            : options.traversal_mode == BvhTraversalMode::lane)
        return 0;
    return is_cpu ? 2 : 1;
}

inline TraceConstants trace_constants(const Device& device, ProxyShape proxy, const TraceOptions& options,
                                      const ImageModel& model) {
    using enum SpecialisationConstantId;
    return {{CHUNK, std::uint32_t(options.chunk)},
            {BOXES, proxy == ProxyShape::boxes ? 1u : 0u},
            {SH_PER_SURFEL, model.sh_direction == ShDirection::surfel ? 1u : 0u},
            {TOGETHER, together_mode(device, options)},
            {SINGLE_DROP_LOGIT, model.single_drop_logit ? 1u : 0u},
            {PRIMITIVE, std::uint32_t(model.primitive)},
            {NORMAL, options.normals ? 1u : 0u},
            {LIKELIHOOD, options.likelihood ? 1u : 0u},
            {MODE, options.mode_gap_m ? 1u : 0u}};
}

}  // namespace relidar
