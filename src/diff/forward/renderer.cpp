// SPDX-License-Identifier: Apache-2.0
// Renders rays: computes surfel records, updates the acceleration structure and runs the
// forward pass. Owns the arrays for the rendered values.
#include <relidar/diff/forward.hpp>

#include <algorithm>
#include <utility>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/gpu/out_of_memory.hpp>

#include "diff/shared/trace.h"
#include "gpu/context.hpp"

namespace relidar {

struct Renderer::Impl {
    Device& device;
    RendererOptions options;
    ImageModel model;
    int highest_sh_degree;
    std::optional<Stream> local_stream;
    Stream& stream;
    DeviceScene scene;
    std::optional<Accel> accel;
    ForwardPass forward;
    bool placed = false;
    glm::vec3 view_origin_m{0.0f};
    Array<DeviceRay> host_rays;  ///< rays that forward() uploads
    Array<shared::RenderedRay> rendered;
    std::optional<KeptHits> kept;
    std::optional<Array<shared::RenderedSurface>> surfaces;
    RenderedBatch batch;

    Impl(Device& d, const Scene& s, const ImageModel& m, const RendererOptions& o)
        : device(d),
          options(o),
          model(m),
          highest_sh_degree(m.sh_degree),
          stream(o.stream ? *o.stream : local_stream.emplace(d, true)),
          scene(d, s),
          accel(std::in_place, d, scene, o.accel),
          forward(d, m, accel->proxy(), o.trace) {
        reserve_rays(o.n_rays);
    }

    void reserve_rays(std::size_t n_rays) {
        // The memory for kept hits is allocated last, because it may shrink. If another
        // allocation fails, `rendered` is empty, so that the next call tries again.
        batch.surfaces = nullptr;
        rendered = {};
        if (options.trace.has_surfaces()) surfaces.emplace(device, n_rays, "surfaces of rays");
        rendered = Array<shared::RenderedRay>(device, n_rays, "rendered rays");
        reduce_kept_hits_to_memory(n_rays);
        batch = {{}, &rendered, nullptr, kept ? &*kept : nullptr, surfaces ? &*surfaces : nullptr};
    }

    /// Allocates memory for the hits that the backward pass reads. Halves their number
    /// until they fit. If hits of a ray are missing, the backward pass traces the ray
    /// again.
    void reduce_kept_hits_to_memory(std::size_t n_threads) {
        for (;; options.keep_hits /= 2) {
            try {
                return allocate_kept_hits(n_threads);
            } catch (const OutOfDeviceMemory&) {
                if (options.keep_hits == 0) throw;
            }
        }
    }

    void allocate_kept_hits(std::size_t n_threads) {
        // Frees the old memory first, because both may not fit. No command reads the old
        // memory any more.
        kept.reset();
        if (options.keep_hits > 0) kept.emplace(device, n_threads, options.keep_hits);
        batch.kept = kept ? &*kept : nullptr;
    }
};

Renderer::Renderer(Device& device, const Scene& scene, const ImageModel& model,
                   const RendererOptions& options)
    : impl_(std::make_unique<Impl>(device, scene, model, options)) {}
Renderer::~Renderer() { wait_for_device(); }

void Renderer::wait_for_device() noexcept {
    // Commands that are recorded on the caller's stream but not yet submitted may use the
    // arrays, too.
    try {
        if (!impl_->local_stream) impl_->stream.finish();
    } catch (const Error&) {  // nothing to do, because a lost device no longer uses memory
    }
    impl_->device.impl().wait_idle();
}

void Renderer::place(const std::vector<InstancePose>& placed, const glm::vec3& view_origin_m) {
    Impl& r = *impl_;
    r.view_origin_m = view_origin_m;
    r.scene.place(r.stream, placed);  // Eq. 4-5 of the paper
    r.scene.activate(r.stream, r.model, view_origin_m);
    r.accel->update(r.stream, r.scene);
    r.placed = true;
}

void Renderer::move(const std::vector<InstancePose>& placed, const glm::vec3& view_origin_m) {
    Impl& r = *impl_;
    if (!r.placed) return place(placed, view_origin_m);
    r.view_origin_m = view_origin_m;
    const bool bends = r.scene.has_new_gait_phases(placed);
    r.scene.place(r.stream, placed);
    if (bends || r.model.sh_direction == ShDirection::surfel)
        r.scene.activate(r.stream, r.model, view_origin_m);
    if (bends) r.accel->refit_animated_actors(r.stream, r.scene);
    else r.accel->move(r.stream, r.scene);
}

void Renderer::record_forward(const RayBatch& rays) {
    Impl& r = *impl_;
    if (!r.placed) throw UsageError("cannot render: the scene has no poses; call place() first");
    if (rays.n_rays > r.rendered.size()) {
        r.stream.finish();
        r.reserve_rays(rays.n_rays);
    }
    // An image can need more threads than rays, because its tiles may extend beyond it.
    if (r.kept && !r.kept->hold(rays)) {
        r.stream.finish();
        r.reduce_kept_hits_to_memory(count_trace_threads(rays));
    }
    r.batch.rays = rays;
    // Eq. 2-4 of the paper
    r.forward.run(r.stream, r.scene, *r.accel, rays, r.rendered, r.kept ? &*r.kept : nullptr,
                  r.batch.surfaces);
}

Rendering Renderer::forward(const WorldRays& rays) {
    Impl& r = *impl_;
    r.stream.finish();  // waits, because earlier commands may still read the rays
    if (rays.size() > r.host_rays.size()) r.host_rays = Array<DeviceRay>(r.device, rays.size(), "rays");
    r.host_rays.upload(to_device_rays(rays));
    record_forward({&r.host_rays, 0, 1, static_cast<std::uint32_t>(rays.size())});
    return download_rendering();
}

void Renderer::check_pass_cap() {
    Impl& r = *impl_;
    r.stream.finish();
    if (const std::uint32_t capped = r.forward.reset_pass_cap_count())
        throw DeviceError(
            fmt::format("cannot trace {} rays: {} of them exceeded the maximum of {} traversal passes or the "
                        "traversal stack; too many surfels may overlap",
                        r.batch.rays.n_rays, capped, RELIDAR_MAX_PASSES));
}

Rendering Renderer::download_rendering() {
    Impl& r = *impl_;
    check_pass_cap();
    const std::size_t n = r.batch.rays.n_rays;
    if (!r.surfaces) return to_rendering(r.rendered.download(n));
    Rendering rendering = to_rendering(r.rendered.download(n), r.surfaces->download(n));
    if (!r.options.trace.normals) rendering.normal.clear();
    if (!r.options.trace.mode_gap_m) rendering.mode_depth.clear();
    return rendering;
}

std::uint32_t Renderer::kept_hits() const { return impl_->options.keep_hits; }

void Renderer::keep_hits(std::uint32_t per_ray) {
    Impl& r = *impl_;
    r.stream.finish();
    const std::uint32_t before = std::exchange(r.options.keep_hits, per_ray);
    const std::size_t n_threads =
        std::max(r.rendered.size(), r.kept ? r.kept->hits.size() / r.kept->per_ray : 0);
    try {
        r.allocate_kept_hits(n_threads);
    } catch (const OutOfDeviceMemory&) {
        r.options.keep_hits = before;
        r.reduce_kept_hits_to_memory(n_threads);
        throw;
    }
}

void Renderer::set_sh_degree(int degree) {
    impl_->model.sh_degree = std::min(impl_->highest_sh_degree, degree);
    impl_->forward.set_sh_degree(impl_->model.sh_degree);
}

void Renderer::upload(const Surfels& surfels) {
    if (surfels.size() != impl_->scene.size())
        throw DataError(fmt::format("cannot upload surfels: found {}, expected {} like in the scene",
                                    surfels.size(), impl_->scene.size()));
    impl_->stream.finish();
    impl_->scene.parameters().upload(surfels);
}

Scene Renderer::download() {
    impl_->stream.finish();
    Scene scene = impl_->scene.layout();
    scene.surfels = impl_->scene.parameters().download();
    return scene;
}

void Renderer::release_accel() {
    impl_->accel.reset();
    impl_->placed = false;
}

void Renderer::make_accel() { impl_->accel.emplace(impl_->device, impl_->scene, impl_->options.accel); }

const RenderedBatch& Renderer::rendered() const { return impl_->batch; }
const ImageModel& Renderer::model() const { return impl_->model; }
Stream& Renderer::stream() { return impl_->stream; }
DeviceScene& Renderer::scene() { return impl_->scene; }
const DeviceScene& Renderer::scene() const { return impl_->scene; }
Accel& Renderer::accel() { return *impl_->accel; }
const ForwardPass& Renderer::forward_pass() const { return impl_->forward; }
const glm::vec3& Renderer::view_origin_m() const { return impl_->view_origin_m; }

}  // namespace relidar
