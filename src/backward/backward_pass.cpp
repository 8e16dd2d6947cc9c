// SPDX-License-Identifier: Apache-2.0
// Binding of backward/trace and scene/activate_vjp: second cast, then the chain rule once a surfel (Eq. 9, M7, M8).
#include <relidar/backward.hpp>

#include <relidar/forward.hpp>

#include "core/assert.hpp"
#include "gpu/stream.hpp"
#include "traversal/trace_scene.hpp"

namespace relidar {

struct BackwardPass::Impl {
    ImageModel model;
    Kernel<shared::BackwardParams> trace;
    Array<std::uint32_t> pass_cap;   ///< the forward pass reports; here it only must not be null
};

namespace {

std::string variant(const Device& device, const TraceOptions& options) {
    return accumulating_variant(device, "backward/trace" + traversal_variant(device, options));
}

}  // namespace

Gradients::Gradients(Device& device, std::uint32_t n_surfels, std::uint32_t n_rays_with_gradient)
    : surfels(device, n_surfels, "gradient"),
      records(device, 16 * std::size_t(n_surfels), "record gradient"),
      touched(device, n_surfels, "touched surfels"),
      view_origin(device, 3, "view origin gradient"),
      rays(n_rays_with_gradient ? Array<float>(device, 6 * std::size_t(n_rays_with_gradient), "ray gradient") : Array<float>()) {}

BackwardPass::BackwardPass(Device& device, const ImageModel& model, Proxy proxy, const TraceOptions& options)
    : impl_(new Impl{model,
                     {device, variant(device, options), trace_constants(device, proxy, options, model)},
                     Array<std::uint32_t>(device, 1, "pass cap count")}) {}
BackwardPass::~BackwardPass() = default;
void BackwardPass::set_sh_degree(int degree) { impl_->model.sh_degree = degree; }

void BackwardPass::run(Stream& stream, DeviceScene& scene, const Accel& accel, const RenderedBatch& batch, const glm::vec3& view_origin_m, Gradients& gradients) {
    RELIDAR_ASSERT_LE(std::size_t(batch.rays.n_rays) * kRenderedFloats, batch.rendered->size());
    RELIDAR_ASSERT_LE(16 * std::size_t(scene.size()), gradients.records.size());
    const ImageModel& model = impl_->model;
    stream.fill(gradients.records);
    stream.fill(gradients.view_origin);
    if (model.sh_direction == ShDirection::ray) stream.fill(gradients.surfels.sh);
    relidar::run(stream, impl_->trace, trace_threads(batch.rays),
                 {trace_scene(scene, accel, batch.rays, model, impl_->pass_cap.address()), batch.rendered->address(), batch.upstream->address(), gradients.records.address(),
                  gradients.surfels.sh.address(), gradients.rays.size() ? gradients.rays.address() : 0});
    scene.activate_vjp(stream, model, view_origin_m, {&gradients.records, &gradients.surfels, &gradients.touched, &gradients.view_origin, gradients.zero_untouched});
}

}  // namespace relidar
