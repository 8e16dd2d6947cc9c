// SPDX-License-Identifier: Apache-2.0
#include <relidar/diff/forward.hpp>

#include <relidar/base/error.hpp>

#include "base/assert.hpp"
#include "base/fail.hpp"
#include "diff/forward/hit_lists.hpp"
#include "diff/traversal/trace_scene.hpp"
#include "gpu/stream.hpp"

namespace relidar {

namespace {

constexpr int kMaxChunk = 64;  // maximum number of hits that a ray sorts at a time

/// Asserts that the arrays of a batch contain all of its rays.
void assert_arrays_fit([[maybe_unused]] const RayBatch& batch) {
    // Index after the last ray of the batch.
    [[maybe_unused]] const std::size_t end = batch.first + (std::size_t(batch.n_rays) - 1) * batch.stride + 1;
    RELIDAR_ASSERT_LE(end, batch.rays->size());
    RELIDAR_ASSERT_LE(batch.targets ? end : 0, batch.targets ? batch.targets->size() : 0);
    // If the batch is an image, all rows have the same length.
    RELIDAR_ASSERT_LE(batch.columns ? batch.n_rays % batch.columns : 0u, 0u);
}

}  // namespace

struct ForwardPass::Impl {
    Device& device;
    ImageModel model;
    TraceOptions options;
    ProxyShape proxy;
    Kernel<shared::ForwardParams> trace{device, "diff/forward/trace", kernel_variant(device),
                                        trace_constants(device, proxy, options, model)};
    Array<std::uint32_t, shared::PassCapCount> pass_cap{device, std::vector<std::uint32_t>{0u},
                                                        "number of truncated rays"};
    Array<std::uint32_t, shared::OverfullCount> n_overfull{device, std::vector<std::uint32_t>{0u},
                                                           "number of rays with more hits than are stored"};
    std::optional<HitListTracer> lists = {};  ///< set if rays write their hits to lists
};

/// Creates the kernel that finds the next few hits of a ray in each pass (a chunk) and
/// blends them. Hit lists, if they are selected, need additional kernels.
ForwardPass::ForwardPass(Device& device, const ImageModel& model, ProxyShape proxy,
                         const TraceOptions& options) {
    if (options.chunk < 1 || options.chunk > kMaxChunk)
        fail<UsageError>("setting trace.chunk: found {}, expected 1 to {}", options.chunk, kMaxChunk);
    const int capacity = options.initial_list_capacity;  // hits per list (one list per ray)
    if (capacity < 1 || capacity > RELIDAR_MOST_ROOM)
        fail<UsageError>("TraceOptions::initial_list_capacity: found {}, expected 1 to {}", capacity,
                         RELIDAR_MOST_ROOM);
    impl_.reset(new Impl{device, model, options, proxy});
    if (uses_hit_lists(device, options))
        impl_->lists.emplace(device, kernel_variant(device), trace_constants(device, proxy, options, model),
                             capacity);
}

ForwardPass::~ForwardPass() = default;
void ForwardPass::set_sh_degree(int degree) { impl_->model.sh_degree = degree; }

void ForwardPass::record_forward(Stream& stream, const DeviceScene& scene, const AccelerationStructure& accel,
                                 const RayBatch& batch, Array<shared::RenderedRay>& rendered_rays,
                                 StoredRayHits* stored_hits, const Array<shared::RenderedSurface>* surfaces) {
    assert_arrays_fit(batch);
    RELIDAR_ASSERT_LE(std::size_t(batch.n_rays), rendered_rays.size());
    RELIDAR_ASSERT_EQ(!stored_hits || stored_hits->can_store_hits(batch), true);
    RELIDAR_ASSERT_LE(impl_->options.writes_surfaces() ? std::size_t(batch.n_rays) : 0,
                      surfaces ? surfaces->size() : 0);
    shared::ForwardParams params = {
        .scene = trace_params(scene, accel, batch, impl_->model, impl_->options, impl_->pass_cap.address()),
        .lists = {},
        .rendered = rendered_rays.address(),
        .kept = address_or_null(stored_hits ? &stored_hits->hits : nullptr),
        .n_overfull = impl_->n_overfull.address(),
        .surfaces = address_or_null(surfaces),
        .n_kept = stored_hits ? stored_hits->per_ray : 0,
        .kept_in_lists = 0,
        .surface_gap_m = impl_->options.mode_gap_m.value_or(0.0f)};
    // Renders with hit lists. Then `trace` renders only the rays whose lists are unfit.
    if (impl_->lists) impl_->lists->render(stream, batch, params, stored_hits);
    relidar::run(stream, impl_->trace, count_threads(batch), params);
}

const Array<std::uint32_t>& ForwardPass::n_truncated_rays() const { return impl_->pass_cap; }
const Array<std::uint32_t>& ForwardPass::n_overflowed_rays() const { return impl_->n_overfull; }

std::uint32_t ForwardPass::consume_truncated() {
    const std::uint32_t count = impl_->pass_cap.download()[0];
    if (count) impl_->pass_cap.upload(std::vector<std::uint32_t>{0u});
    return count;
}

RenderedRayValues to_ray_values(const std::vector<shared::RenderedRay>& rays,
                                const std::vector<shared::RenderedSurface>& surfaces) {
    RenderedRayValues result;
    for (const shared::RenderedRay& ray : rays) {
        // Appends depth, weight, intensity and the two logits, which the list names.
#define RELIDAR_APPEND(name, ...) result.name.push_back(ray.name);
        RELIDAR_IMAGE_VALUES(RELIDAR_APPEND)
#undef RELIDAR_APPEND
        result.transmittance.push_back(ray.transmittance);
        result.median_depth.push_back(ray.median_depth);
        result.hits.push_back(ray.n_hits);
        result.instance.push_back(ray.instance == RELIDAR_NO_INSTANCE ? -1 : std::int32_t(ray.instance));
    }
    for (const shared::RenderedSurface& surface : surfaces) {
        result.normal.push_back(surface.normal);
        result.mode_depth.push_back(surface.mode);
    }
    return result;
}

}  // namespace relidar
