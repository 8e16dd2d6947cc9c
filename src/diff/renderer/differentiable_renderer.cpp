// SPDX-License-Identifier: Apache-2.0
#include <relidar/diff/differentiable_renderer.hpp>

#include <algorithm>
#include <optional>

#include <relidar/base/error.hpp>

#include "base/fail.hpp"

namespace relidar {

namespace {

constexpr std::size_t kRayGradientFloats = 6;  // of a ray gradient, dL/d(origin, direction)

/// Returns the number of rays for which the renderer has memory.
std::uint32_t max_batch_rays(const Renderer& renderer) {
    return std::uint32_t(renderer.last_batch().rendered->size());
}

/// Gradient of one rendered value, for example of the depth: an array of the caller, and
/// the member of a ray's struct that receives its entries.
struct UpstreamGradient {
    const char* name;
    const std::vector<float>& values;
    float shared::RayGradient::*member;
};

/// Converts one array per rendered value to one struct per ray, because the backward pass
/// reads structs. An empty array leaves zeros.
std::vector<shared::RayGradient> ray_gradients(const RenderedGradients& gradients, std::size_t n_rays) {
    // The list contains depth, weight, intensity, hit_logit and drop_logit.
    using shared::RayGradient;
#define RELIDAR_ROW(name, ...) {#name, gradients.name, &RayGradient::name},
    const UpstreamGradient upstream_gradients[] = {RELIDAR_IMAGE_VALUES(RELIDAR_ROW)};
#undef RELIDAR_ROW
    std::vector<RayGradient> result(n_rays);
    for (const UpstreamGradient& upstream : upstream_gradients) {
        if (upstream.values.empty()) continue;
        if (upstream.values.size() != n_rays)
            fail(
                "cannot use the gradient array of the rendered value '{}': found {} values, expected {} "
                "values (one for each ray) or an empty array",
                upstream.name, upstream.values.size(), n_rays);
        for (std::size_t ray = 0; ray < n_rays; ++ray) result[ray].*upstream.member = upstream.values[ray];
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
    Array<shared::RayGradient> upstream;       ///< dL/d(rendered values) of each ray, which losses write

    Impl(Device& device, const Scene& scene, const ImageModel& model, const RendererOptions& renderer_options,
         const GradientOptions& gradient_options)
        : renderer(device, scene, model, renderer_options),
          options(gradient_options),
          backward(device, model, renderer.accel().proxy_shape(), renderer_options.trace,
                   gradient_options.sums),
          upstream(device, renderer_options.n_rays, "loss gradients") {
        allocate_gradients();
    }
    void allocate_gradients() {
        gradients.emplace(renderer.stream().device(), renderer.scene(), options.requested_gradients,
                          max_batch_rays(renderer));
        gradients->zero_untouched = options.zero_untouched;
        // No kernel writes the coefficients above the degree of the model.
        renderer.stream().fill(gradients->surfels.sh);
    }
};

/// Creates the renderer, the kernels of the backward pass, and the arrays of gradients
/// for the scene and for batches of options.n_rays rays.
DifferentiableRenderer::DifferentiableRenderer(Device& device, const Scene& scene, const ImageModel& model,
                                               const RendererOptions& options,
                                               const GradientOptions& gradients)
    : impl_(new Impl(device, scene, model, options, gradients)) {}

/// Waits, because the device may still use the arrays that are freed now.
DifferentiableRenderer::~DifferentiableRenderer() { impl_->renderer.wait_for_device(); }

/// Returns the last batch with an array for the gradients of its rendered values.
/// Enlarges all arrays with an entry per ray if the batch was larger than all before.
RenderedBatch DifferentiableRenderer::last_batch() {
    Renderer& renderer = impl_->renderer;
    Device& device = renderer.stream().device();
    const std::size_t n_rays = max_batch_rays(renderer);
    if (impl_->upstream.size() < n_rays) {
        renderer.stream().submit_and_wait();
        impl_->upstream = Array<shared::RayGradient>(device, n_rays, "loss gradients");
        if (impl_->options.requested_gradients.rays)
            impl_->gradients->rays = {device, kRayGradientFloats * n_rays, "ray gradient"};
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
    const RenderedBatch batch = last_batch();
    const std::size_t n_rays = batch.rays.n_rays;
    if (batch.rays.rays == nullptr)
        throw UsageError("cannot compute gradients: no rays were rendered; run the forward pass first");
    Stream& stream = impl_->renderer.stream();
    stream.submit_and_wait();
    impl_->upstream.upload(ray_gradients(rendered_gradients, n_rays));
    record_backward();
    stream.submit_and_wait();
    const DeviceGradients& gradients = *impl_->gradients;
    return {.surfels = gradients.surfels.download(),
            .touched = gradients.touched.download(impl_->renderer.scene().size()),
            .poses = download_array(gradients.poses, gradients.poses.size()),
            .sensor = download_array(gradients.sensor, gradients.sensor.size()),
            .rays = download_array(gradients.rays, kRayGradientFloats * n_rays)};
}

/// Calls `change_surfels`, which adds or removes surfels. Before, frees the acceleration
/// structure and the gradients, whose memory can then be used for copies of the surfels.
void DifferentiableRenderer::resize(
    const std::function<void(double reserved_bytes_per_surfel)>& change_surfels) {
    Renderer& renderer = impl_->renderer;
    const Device& device = renderer.stream().device();
    renderer.stream().submit_and_wait();
    const std::uint64_t bytes_before = device.allocated_bytes();
    renderer.release_accel();
    impl_->gradients.reset();
    // The call must leave this memory free for the new structure and gradients, whose
    // size is proportional to the number of surfels.
    const auto freed_bytes = double(bytes_before - device.allocated_bytes());
    change_surfels(freed_bytes / std::max(renderer.scene().size(), 1u));
    impl_->allocate_gradients();
    renderer.create_accel();
}

Renderer& DifferentiableRenderer::renderer() { return impl_->renderer; }
const Renderer& DifferentiableRenderer::renderer() const { return impl_->renderer; }
DeviceGradients& DifferentiableRenderer::gradients() { return *impl_->gradients; }
BackwardPass& DifferentiableRenderer::backward_pass() { return impl_->backward; }

}  // namespace relidar
