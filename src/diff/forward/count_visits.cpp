// SPDX-License-Identifier: Apache-2.0
// Runs the forward pass with kernels that count visited nodes and surfels. These are
// separate kernel variants, so that normal rendering does not become slower.
#include "diff/forward/count_visits.hpp"

#include "diff/forward/hit_lists.hpp"
#include "diff/traversal/trace_scene.hpp"
#include "gpu/stream.hpp"

namespace relidar {

std::optional<VisitCounts> count_visits(Device& device, const DeviceScene& scene,
                                        const AccelerationStructure& accel, const RayBatch& batch,
                                        const ImageModel& model, const TraceOptions& options) {
    if (device.backend() != RayTracingBackend::software || is_brute_force(device)) return std::nullopt;
    TraceConstants constants = trace_constants(device, accel.proxy_shape(), options, model);
    constants.push_back({SpecialisationConstantId::COUNT_VISITS, 1u});
    const Kernel<shared::ForwardParams> trace(device, "diff/forward/trace", KernelVariant("@software_bvh"),
                                              constants);
    const Array<shared::RenderedRay> rendered(device, batch.n_rays, "rendered rays");
    const Array<std::uint32_t, shared::PassCapCount> pass_cap(device, std::vector<std::uint32_t>{0u},
                                                              "number of truncated rays");
    const Array<std::uint32_t, shared::VisitCounters> visits(device, std::vector<std::uint32_t>{0u, 0u},
                                                             "visits");
    shared::TraceScene traced = trace_params(scene, accel, batch, model, options, pass_cap.address());
    traced.visits = visits.address();
    Stream stream(device);
    shared::ForwardParams params{};
    params.scene = traced;
    params.rendered = rendered.address();
    params.surface_gap_m = options.mode_gap_m.value_or(0.0f);
    std::optional<HitListTracer> lists;
    if (uses_hit_lists(device, options)) {
        lists.emplace(device, KernelVariant("@software_bvh"), constants, RELIDAR_MOST_ROOM);
        lists->render(stream, batch, params, nullptr);
    }
    run(stream, trace, count_threads(batch), params);
    stream.submit_and_wait();
    const std::vector<std::uint32_t> sums = visits.download();
    return VisitCounts{double(sums[0]) / batch.n_rays, double(sums[1]) / batch.n_rays};
}

}  // namespace relidar
