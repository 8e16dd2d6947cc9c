// SPDX-License-Identifier: Apache-2.0
#include <relidar/diff/forward.hpp>

#include <algorithm>
#include <utility>

#include <relidar/base/error.hpp>
#include <relidar/gpu/out_of_memory.hpp>

#include "base/fail.hpp"
#include "diff/shared/trace.h"
#include "gpu/context.hpp"

namespace relidar {

struct Renderer::Impl {
    Device& device;
    RendererOptions options;
    ImageModel model;
    int highest_sh_degree = model.sh_degree;
    std::optional<Stream> local_stream;
    Stream& stream = options.stream ? *options.stream : local_stream.emplace(device, true);
    DeviceScene scene;
    std::optional<AccelerationStructure> accel{std::in_place, device, scene, options.accel};
    ForwardPass forward{device, model, accel->proxy_shape(), options.trace};
    bool is_ready = false;  ///< true if the instances have poses and the trees are built
    bool appended = false;  ///< true if models were added after the last full build of the trees
    glm::vec3 view_origin_m{0.0f};
    Array<DeviceRay> host_rays;  ///< rays that render_rays() uploads
    Array<shared::RenderedRay> rendered;
    std::optional<StoredRayHits> stored_hits;
    std::optional<Array<shared::RenderedSurface>> surfaces;
    RenderedBatch batch;

    Impl(Device& d, const Scene& s, const ImageModel& m, const RendererOptions& o)
        : device(d), options(o), model(m), scene(d, s) {
        allocate_rays(o.n_rays);
    }

    void allocate_rays(std::size_t n_rays) {
        // If an allocation fails, `rendered` stays empty, and the next call tries again.
        // The hit storage is allocated last, because it can be made smaller to fit.
        batch.surfaces = nullptr;
        rendered = {};
        if (options.trace.writes_surfaces()) surfaces.emplace(device, n_rays, "surfaces of rays");
        rendered = Array<shared::RenderedRay>(device, n_rays, "rendered rays");
        fit_hit_storage(n_rays);
        batch = {
            {}, &rendered, nullptr, stored_hits ? &*stored_hits : nullptr, surfaces ? &*surfaces : nullptr};
    }

    /// Allocates memory for the hits that the backward pass reads. Halves the number of
    /// hits per ray until they fit, because the backward pass can search missing hits.
    void fit_hit_storage(std::size_t n_threads) {
        for (;; options.keep_hits /= 2) {
            try {
                return allocate_hits(n_threads);
            } catch (const OutOfDeviceMemory&) {
                if (options.keep_hits == 0) throw;
            }
        }
    }

    void allocate_hits(std::size_t n_threads) {
        // Frees the old memory first, because the device may not have enough memory for
        // both. No command still reads the old memory.
        stored_hits.reset();
        if (options.keep_hits > 0) stored_hits.emplace(device, n_threads, options.keep_hits);
        batch.stored_hits = stored_hits ? &*stored_hits : nullptr;
    }
};

Renderer::Renderer(Device& device, const Scene& scene, const ImageModel& model,
                   const RendererOptions& options)
    : impl_(new Impl(device, scene, model, options)) {}

Renderer::~Renderer() { wait_for_device(); }

void Renderer::wait_for_device() noexcept {
    // A stream of the caller may contain commands that use the renderer's arrays and are
    // not submitted yet.
    try {
        if (!impl_->local_stream) impl_->stream.submit_and_wait();
    } catch (const Error&) {  // nothing to do, because a lost device no longer uses memory
    }
    impl_->device.impl().wait_idle();
}

/// Records the commands that prepare the scene for rendering, after surfels have changed.
/// They compute the poses of the instances (Eq. 4-5 of the paper), the surfel values that
/// depend on the view, and the boxes of the acceleration structure.
void Renderer::update(const std::vector<InstancePose>& instance_poses, const glm::vec3& view_origin_m) {
    Impl& r = *impl_;
    if (r.appended) {
        // The trees have memory to refit the appended models, but not to rebuild them.
        r.appended = false;
        r.stream.submit_and_wait();
        r.accel.reset();
        create_accel();
    }
    r.view_origin_m = view_origin_m;
    r.scene.stage_poses(r.stream, instance_poses);
    r.scene.activate(r.stream, r.model, view_origin_m);
    r.accel->record_refit(r.stream, r.scene);
    r.is_ready = true;
}

/// Records new poses of unchanged surfels. Rigid models need only new poses. Models with
/// a gait (walking persons) change their shape, so they need new surfel values and a
/// refit.
void Renderer::record_poses(const std::vector<InstancePose>& instance_poses, const glm::vec3& view_origin_m) {
    Impl& r = *impl_;
    if (!r.is_ready) {
        update(instance_poses, view_origin_m);
        return;
    }
    r.view_origin_m = view_origin_m;
    const bool changes_shape = r.scene.moves_gait(instance_poses);
    r.scene.stage_poses(r.stream, instance_poses);
    // Per-surfel harmonics are evaluated for the direction from the view origin.
    const bool depends_on_view = r.model.sh_direction == ShDirection::surfel;
    if (changes_shape || depends_on_view) r.scene.activate(r.stream, r.model, view_origin_m);
    if (changes_shape) r.accel->refit_animated(r.stream, r.scene);
    else r.accel->record_top_level(r.stream, r.scene);
}

/// Records the rendering of a batch. If it is the largest so far, enlarges the arrays of
/// the results, after the commands that use the old arrays are finished.
void Renderer::record_forward(const RayBatch& rays) {
    Impl& r = *impl_;
    if (!r.is_ready)
        throw UsageError("cannot render: the models of the scene have no poses yet; place them first");
    if (rays.n_rays > r.rendered.size()) {
        r.stream.submit_and_wait();
        r.allocate_rays(rays.n_rays);
    }
    // Each thread stores hits. An image (complete tiles) can have more threads than rays.
    if (r.stored_hits && !r.stored_hits->can_store_hits(rays)) {
        r.stream.submit_and_wait();
        r.fit_hit_storage(count_threads(rays));
    }
    r.batch.rays = rays;
    r.forward.record_forward(r.stream, r.scene, *r.accel, rays, r.rendered,
                             r.stored_hits ? &*r.stored_hits : nullptr, r.batch.surfaces);
}

RenderedRayValues Renderer::render_rays(const WorldRays& rays) {
    Impl& r = *impl_;
    r.stream.submit_and_wait();  // waits, because earlier commands may still read the rays
    if (rays.size() > r.host_rays.size()) r.host_rays = Array<DeviceRay>(r.device, rays.size(), "rays");
    r.host_rays.upload(to_device_rays(rays));
    record_forward({&r.host_rays, 0, 1, std::uint32_t(rays.size())});
    return download_rays();
}

void Renderer::check_truncation() {
    Impl& r = *impl_;
    r.stream.submit_and_wait();
    if (const std::uint32_t capped = r.forward.consume_truncated())
        fail<DeviceError>(
            "cannot trace {} rays: the search for surfels stopped {} times at its limit ({} passes or a full "
            "stack), because too many surfels overlap; use a scene with smaller or fewer surfels",
            r.batch.rays.n_rays, capped, RELIDAR_MAX_PASSES);
}

RenderedRayValues Renderer::download_rays() {
    Impl& r = *impl_;
    check_truncation();
    const std::size_t n = r.batch.rays.n_rays;
    if (!r.surfaces) return to_ray_values(r.rendered.download(n));
    RenderedRayValues rendering = to_ray_values(r.rendered.download(n), r.surfaces->download(n));
    // The device array contains both values. Removes the value that was not requested.
    if (!r.options.trace.normals) rendering.normal.clear();
    if (!r.options.trace.mode_gap_m) rendering.mode_depth.clear();
    return rendering;
}

std::uint32_t Renderer::stored_hits_per_ray() const { return impl_->options.keep_hits; }

void Renderer::set_stored_hits(std::uint32_t hits_per_ray) {
    Impl& r = *impl_;
    r.stream.submit_and_wait();
    const std::uint32_t old_hits_per_ray = r.options.keep_hits;
    // The memory is per thread. An earlier batch may have had more threads than rays.
    const std::size_t n_old_threads = r.stored_hits ? r.stored_hits->hits.size() / r.stored_hits->per_ray : 0;
    const std::size_t n_threads = std::max(r.rendered.size(), n_old_threads);
    r.options.keep_hits = hits_per_ray;
    try {
        r.allocate_hits(n_threads);
    } catch (const OutOfDeviceMemory&) {
        // allocate_hits() has already freed the old memory. Allocates it again, or less.
        r.options.keep_hits = old_hits_per_ray;
        r.fit_hit_storage(n_threads);
        throw;
    }
}

void Renderer::set_sh_degree(int degree) {
    impl_->model.sh_degree = std::min(impl_->highest_sh_degree, degree);
    impl_->forward.set_sh_degree(impl_->model.sh_degree);
}

void Renderer::upload_surfels(const Surfels& surfels) {
    if (surfels.size() != impl_->scene.size())
        fail("cannot upload surfels: found {} surfels, expected {} like in the scene", surfels.size(),
             impl_->scene.size());
    impl_->stream.submit_and_wait();
    impl_->scene.surfel_parameters().upload(surfels);
}

Scene Renderer::download_scene() {
    impl_->stream.submit_and_wait();
    Scene scene = impl_->scene.layout();
    scene.surfels = impl_->scene.surfel_parameters().download();
    return scene;
}

std::uint32_t Renderer::append_model(const Scene& added) {
    Impl& r = *impl_;
    Scene model = added;
    // If some models of the scene walk, all models need the parameters of a gait.
    if (r.scene.surfel_parameters().bends && !model.surfels.bends) model.surfels.add_still_gait();
    r.scene.surfel_parameters().check_group(model.surfels);
    // A model can only be appended to built trees, and update() builds them.
    if (!r.is_ready) update(r.scene.poses(), r.view_origin_m);
    // Computes the values that kernels read (activation) in a scene with only this model,
    // and then copies them. The values of the other models stay valid.
    DeviceScene activated(r.device, model);
    activated.activate(r.stream, r.model, r.view_origin_m);
    r.stream.submit_and_wait();
    r.scene.append_model(r.device, activated);
    r.appended = true;  // before the next call, which may fail: update() creates new trees
    r.accel->append_model(r.stream, r.scene, activated);
    return std::uint32_t(r.scene.layout().models.size() - 1);
}

std::uint32_t Renderer::append_instance(const ModelInstance& instance) {
    Impl& r = *impl_;
    if (!r.is_ready) update(r.scene.poses(), r.view_origin_m);
    r.stream.submit_and_wait();
    r.scene.append_instance(r.device, instance);
    r.accel->append_instances(r.scene);
    return std::uint32_t(r.scene.layout().instances.size() - 1);
}

void Renderer::release_accel() {
    impl_->accel.reset();
    impl_->is_ready = false;
}

void Renderer::create_accel() { impl_->accel.emplace(impl_->device, impl_->scene, impl_->options.accel); }

const RenderedBatch& Renderer::last_batch() const { return impl_->batch; }
const ImageModel& Renderer::model() const { return impl_->model; }
Stream& Renderer::stream() { return impl_->stream; }
DeviceScene& Renderer::scene() { return impl_->scene; }
const DeviceScene& Renderer::scene() const { return impl_->scene; }
AccelerationStructure& Renderer::accel() { return *impl_->accel; }
const ForwardPass& Renderer::forward_pass() const { return impl_->forward; }
const glm::vec3& Renderer::view_origin_m() const { return impl_->view_origin_m; }

}  // namespace relidar
