// SPDX-License-Identifier: Apache-2.0
#include <relidar/diff/differentiable_renderer.hpp>

#include <algorithm>
#include <optional>

#include <relidar/base/error.hpp>

#include "base/fail.hpp"

namespace relidar {

namespace {

std::uint32_t max_batch_rays(const Renderer& renderer) {
    return std::uint32_t(renderer.last_batch().rendered->size());
}

struct UpstreamGradientField {
    const char* name;
    const std::vector<float>& values;
    float shared::RayGradient::*at;
};

/// Converts one array per rendered value to one struct per ray, because the backward pass
/// reads structs.
std::vector<shared::RayGradient> ray_gradients(const RenderedGradients& gradients, std::size_t n_rays) {
    using shared::RayGradient;
#define RELIDAR_LANE(name, built, value, input, slope, meaning) {#name, gradients.name, &RayGradient::name},
    const UpstreamGradientField lanes[] = {RELIDAR_IMAGE_VALUES(RELIDAR_LANE)};
#undef RELIDAR_LANE
    std::vector<RayGradient> result(n_rays);
    for (const auto& [name, values, at] : lanes) {
        if (values.empty()) continue;
        if (values.size() != n_rays)
            fail(
                "cannot use the gradient array of the rendered value '{}': found {} values, expected {} "
                "values (one for each ray) or an empty array",
                name, values.size(), n_rays);
        for (std::size_t i = 0; i < n_rays; ++i) result[i].*at = values[i];
    }
    return result;
}

/// Downloads an array of gradients. Returns nothing if the gradients were not requested,
/// because the array is then empty.
std::vector<float> download_array(const Array<float>& array, std::size_t count) {
    return array.size() ? array.download(count) : std::vector<float>{};
}

}  // namespace

struct DifferentiableRenderer::Impl {
    Renderer renderer;
    GradientOptions options;
    BackwardPass backward;
    std::optional<DeviceGradients> gradients;  ///< no value while surfels are added or removed
    Array<shared::RayGradient> upstream;

    Impl(Device& device, const Scene& scene, const ImageModel& model, const RendererOptions& of_renderer,
         const GradientOptions& of_gradients)
        : renderer(device, scene, model, of_renderer),
          options(of_gradients),
          backward(device, model, renderer.accel().proxy_shape(), of_renderer.trace, of_gradients.sums),
          upstream(device, of_renderer.n_rays, "loss gradients") {
        allocate();
    }
    void allocate() {
        gradients.emplace(renderer.stream().device(), renderer.scene(), options.requested_gradients,
                          max_batch_rays(renderer));
        gradients->zero_untouched = options.zero_untouched;
        // No kernel writes the coefficients above the degree of the model.
        renderer.stream().fill(gradients->surfels.sh);
    }
};

DifferentiableRenderer::DifferentiableRenderer(Device& device, const Scene& scene, const ImageModel& model,
                                               const RendererOptions& o, const GradientOptions& gradients)
    : impl_(new Impl(device, scene, model, o, gradients)) {}

DifferentiableRenderer::~DifferentiableRenderer() { impl_->renderer.wait_for_device(); }

RenderedBatch DifferentiableRenderer::last_batch() {
    Renderer& renderer = impl_->renderer;
    Device& device = renderer.stream().device();
    const std::size_t n_rays = max_batch_rays(renderer);
    if (impl_->upstream.size() < n_rays) {  // the maximum number of rays per batch has grown
        renderer.stream().submit_and_wait();
        impl_->upstream = Array<shared::RayGradient>(device, n_rays, "loss gradients");
        if (impl_->options.requested_gradients.rays)
            impl_->gradients->rays = {device, 6 * n_rays, "ray gradient"};
    }
    RenderedBatch result = renderer.last_batch();
    result.upstream = &impl_->upstream;
    return result;
}

void DifferentiableRenderer::record_backward() {
    Renderer& renderer = impl_->renderer;
    impl_->backward.set_sh_degree(renderer.model().sh_degree);
    impl_->backward.record_backward(renderer.stream(), renderer.scene(), renderer.accel(), last_batch(),
                                    renderer.view_origin_m(), *impl_->gradients);
}

HostGradients DifferentiableRenderer::backpropagate(const RenderedGradients& rendered_gradients) {
    const RenderedBatch last = last_batch();
    const std::size_t n_rays = last.rays.n_rays;
    if (last.rays.rays == nullptr)
        throw UsageError("cannot compute gradients: no rays were rendered; run the forward pass first");
    Stream& stream = impl_->renderer.stream();
    stream.submit_and_wait();
    impl_->upstream.upload(ray_gradients(rendered_gradients, n_rays));
    record_backward();
    stream.submit_and_wait();
    const DeviceGradients& g = *impl_->gradients;
    return {g.surfels.download(), g.touched.download(impl_->renderer.scene().size()),
            download_array(g.poses, g.poses.size()), download_array(g.sensor, g.sensor.size()),
            download_array(g.rays, 6 * n_rays)};
}

/// Calls `change_surfels`, which adds or removes surfels. Frees the acceleration
/// structure and the gradients before the call, so that their memory can be used during
/// the copy.
void DifferentiableRenderer::resize(const std::function<void(double reserved_bytes)>& change_surfels) {
    Renderer& renderer = impl_->renderer;
    const Device& device = renderer.stream().device();
    renderer.stream().submit_and_wait();
    const std::uint64_t before = device.allocated_bytes();
    renderer.release_accel();
    impl_->gradients.reset();
    // Reports how many bytes per surfel are allocated again after the call.
    change_surfels(double(before - device.allocated_bytes()) / std::max(renderer.scene().size(), 1u));
    impl_->allocate();
    renderer.create_accel();
}

Renderer& DifferentiableRenderer::renderer() { return impl_->renderer; }
const Renderer& DifferentiableRenderer::renderer() const { return impl_->renderer; }
DeviceGradients& DifferentiableRenderer::gradients() { return *impl_->gradients; }
BackwardPass& DifferentiableRenderer::backward_pass() { return impl_->backward; }

}  // namespace relidar
