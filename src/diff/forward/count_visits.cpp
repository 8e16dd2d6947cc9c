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
    const KernelVariant variant("@software_bvh");
    TraceConstants constants = trace_constants(device, accel.proxy_shape(), options, model);
    constants.push_back({SpecialisationConstantId::COUNT_VISITS, 1u});  // other kernels do not count
    const Kernel<shared::ForwardParams> trace(device, "diff/forward/trace", variant, constants);
    std::optional<HitListTracer> lists;
    if (uses_hit_lists(device, options)) lists.emplace(device, variant, constants, RELIDAR_MOST_ROOM);

    // Rendered rays and truncated rays must be written, but nothing reads them.
    const Array<shared::RenderedRay> rendered(device, batch.n_rays, "rendered rays");
    const Array<std::uint32_t, shared::PassCapCount> n_truncated(device, std::vector<std::uint32_t>{0u},
                                                                 "number of truncated rays");
    const Array<std::uint32_t, shared::VisitCounters> visits(device, std::vector<std::uint32_t>{0u, 0u},
                                                             "visits");
    shared::ForwardParams params{};
    params.scene = trace_params(scene, accel, batch, model, options, n_truncated.address());
    params.scene.visits = visits.address();
    params.rendered = rendered.address();
    params.surface_gap_m = options.mode_gap_m.value_or(0.0f);

    Stream stream(device);
    // Lists render most rays, and `trace` the others. Without lists, `trace` renders all.
    if (lists) lists->render(stream, batch, params, nullptr);
    run(stream, trace, count_threads(batch), params);
    stream.submit_and_wait();
    const std::vector<std::uint32_t> sums = visits.download();  // nodes, surfels
    return VisitCounts{.nodes = double(sums[0]) / batch.n_rays, .surfels = double(sums[1]) / batch.n_rays};
}

}  // namespace relidar
