// SPDX-License-Identifier: Apache-2.0
// Adds the backward pass and its gradients to the renderer.
#include <relidar/diff/differentiable_renderer.hpp>

#include <algorithm>
#include <optional>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

namespace relidar {

namespace {

/// Returns the maximum number of rays per batch.
std::uint32_t room(const Renderer& renderer) {
    return static_cast<std::uint32_t>(renderer.rendered().rendered->size());
}

struct Lane {
    const char* name;
    const std::vector<float>& values;
    float shared::RayGradient::*at;
};

/// Converts the gradients of rendered values to the memory layout that the backward pass
/// expects.
std::vector<shared::RayGradient> make_ray_gradients(const RenderedGradients& gradients, std::size_t n_rays) {
    using shared::RayGradient;
#define RELIDAR_LANE(name, built, value, input, slope, meaning) {#name, gradients.name, &RayGradient::name},
    const Lane lanes[] = {RELIDAR_IMAGE_VALUES(RELIDAR_LANE)};
#undef RELIDAR_LANE
    std::vector<RayGradient> result(n_rays);
    for (const auto& [name, values, at] : lanes) {
        if (values.empty()) continue;
        if (values.size() != n_rays)
            throw DataError(fmt::format(
                "cannot use the gradients of the rendered {}: found {} values, expected {}, one for each "
                "ray, or none",
                name, values.size(), n_rays));
        for (std::size_t i = 0; i < n_rays; ++i) result[i].*at = values[i];
    }
    return result;
}

/// Downloads an array from the device. Returns an empty vector if the gradient was not
/// requested, because the array is then empty.
std::vector<float> values_of(const Array<float>& array, std::size_t count) {
    return array.size() ? array.download(count) : std::vector<float>{};
}

}  // namespace

struct DifferentiableRenderer::Impl {
    GradientOptions options;
    BackwardPass backward;
    std::optional<Gradients> gradients;  ///< no value while surfels are added or removed
    Array<shared::RayGradient> upstream;

    void make_gradients(Renderer& renderer) {
        gradients.emplace(renderer.stream().device(), renderer.scene(), options.wanted, room(renderer));
        gradients->zero_untouched = options.zero_untouched;
    }
};

DifferentiableRenderer::DifferentiableRenderer(Device& device, const Scene& scene, const ImageModel& model,
                                               const RendererOptions& options,
                                               const GradientOptions& gradients)
    : Renderer(device, scene, model, options),
      impl_(new Impl{gradients,
                     BackwardPass(device, model, accel().proxy(), options.trace, gradients.sums),
                     std::nullopt,
                     {device, options.n_rays, "loss gradients"}}) {
    impl_->make_gradients(*this);
}

DifferentiableRenderer::~DifferentiableRenderer() = default;

RenderedBatch DifferentiableRenderer::batch() {
    Device& device = stream().device();
    const std::size_t n_rays = room(*this);
    if (impl_->upstream.size() < n_rays) {  // the maximum number of rays per batch has grown
        stream().finish();
        impl_->upstream = Array<shared::RayGradient>(device, n_rays, "loss gradients");
        if (impl_->options.wanted.rays) impl_->gradients->rays = {device, 6 * n_rays, "ray gradient"};
    }
    RenderedBatch result = rendered();
    result.upstream = &impl_->upstream;
    return result;
}

void DifferentiableRenderer::record_backward() {
    impl_->backward.set_sh_degree(model().sh_degree);
    // Eq. 9 of the paper
    impl_->backward.run(stream(), scene(), accel(), batch(), view_origin_m(), *impl_->gradients);
}

HostGradients DifferentiableRenderer::backward(const RenderedGradients& d_rendered) {
    const RenderedBatch last = batch();
    const std::size_t n_rays = last.rays.n_rays;
    if (last.rays.rays == nullptr)
        throw UsageError("cannot compute gradients: nothing was rendered; call forward() first");
    stream().finish();
    impl_->upstream.upload(make_ray_gradients(d_rendered, n_rays));
    record_backward();
    stream().finish();
    const Gradients& g = *impl_->gradients;
    return {g.surfels.download(), g.touched.download(scene().size()), values_of(g.poses, g.poses.size()),
            values_of(g.sensor, g.sensor.size()), values_of(g.rays, 6 * n_rays)};
}

void DifferentiableRenderer::change_surfels(const std::function<void(double others_bytes)>& change) {
    const Device& device = stream().device();
    stream().finish();
    const std::uint64_t before = device.allocated_bytes();
    release_accel();
    impl_->gradients.reset();
    change(double(before - device.allocated_bytes()) / std::max(scene().size(), 1u));
    impl_->make_gradients(*this);
    make_accel();
}

Gradients& DifferentiableRenderer::gradients() { return *impl_->gradients; }
BackwardPass& DifferentiableRenderer::backward_pass() { return impl_->backward; }

}  // namespace relidar
