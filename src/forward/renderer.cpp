// SPDX-License-Identifier: Apache-2.0
// A scene ready to be traced: the composition of activation, acceleration structure and forward pass for one-off rendering.
#include <relidar/stages/forward.hpp>

#include <fmt/format.h>

#include <relidar/error.hpp>

#include "traversal/trace_scene.hpp"
#include "gpu/stream.hpp"

namespace relidar {

struct Renderer::Impl {
    Device& device;
    ImageModel model;
    Stream stream;
    DeviceScene scene;
    Accel accel;
    ForwardPass forward;
    bool built = false;
    Array<DeviceRay> rays;
    Array<shared::RenderedRay> rendered;
    const bool with_geometry;
    std::optional<RayGeometry> geometry;   ///< where it is wanted

    Impl(Device& d, const Scene& s, const ImageModel& m, const AccelOptions& a, const TraceOptions& t)
        : device(d), model(m), stream(d, true), scene(d, s), accel(d, scene, a), forward(d, m, accel.proxy(), t), with_geometry(t.geometry) {}
};

Renderer::Renderer(Device& device, const Scene& scene, const ImageModel& model, const AccelOptions& accel, const TraceOptions& trace)
    : impl_(std::make_unique<Impl>(device, scene, model, accel, trace)) {}
Renderer::~Renderer() = default;
void Renderer::set_poses(const std::vector<Pose>& world_from_instance) { impl_->scene.set_poses(world_from_instance); }
void Renderer::place(const std::vector<InstancePose>& placed) { impl_->scene.place(impl_->stream, placed); }
const KernelTimes& Renderer::times() const { return impl_->stream.times(); }
void Renderer::reset_times() { impl_->stream.reset_times(); }

Rendering Renderer::trace(const WorldRays& rays, const glm::vec3& view_origin_m) {
    Impl& r = *impl_;
    if (rays.size() != r.rays.size()) {
        r.rays = Array<DeviceRay>(r.device, rays.size(), "rays");
        r.rendered = Array<shared::RenderedRay>(r.device, rays.size(), "rendered rays");
        if (r.with_geometry) r.geometry.emplace(r.device, rays.size());
    }
    r.rays.upload(to_device_rays(rays));
    if (!r.built || r.model.sh_direction == ShDirection::surfel) r.scene.activate(r.stream, r.model, view_origin_m);
    if (r.built) r.accel.move(r.stream, r.scene);
    else r.accel.update(r.stream, r.scene);
    r.built = true;
    RayGeometry* const geometry = r.geometry ? &*r.geometry : nullptr;
    r.forward.run(r.stream, r.scene, r.accel, {&r.rays, 0, 1, static_cast<std::uint32_t>(rays.size())}, r.rendered, nullptr, geometry);
    r.stream.finish();
    if (const std::uint32_t capped = r.forward.take_pass_cap_count())
        throw DeviceError(fmt::format("tracing {} rays: {} of them reached the cap of {} passes or filled the traversal stack, expected every ray to end", rays.size(), capped, RELIDAR_MAX_PASSES));
    if (!geometry) return to_rendering(r.rendered.download());
    return to_rendering(r.rendered.download(), geometry->rendered.download());
}

}  // namespace relidar
