// SPDX-License-Identifier: Apache-2.0
// The backward pass behind a renderer's forward pass, and the gradients between them.
#include <relidar/stages/differentiable_renderer.hpp>

#include <algorithm>
#include <array>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include <relidar/error.hpp>

namespace relidar {

namespace {

/// Rays that a renderer has room for.
std::uint32_t room(const Renderer& renderer) { return static_cast<std::uint32_t>(renderer.rendered().rendered->size() / kRenderedFloats); }

/// Values as the backward pass reads them. @return [n_rays, kUpstreamFloats]
std::vector<float> interleaved(const RenderedGradients& d, std::size_t n_rays) {
    const std::array<std::pair<const char*, const std::vector<float>*>, kUpstreamFloats> lanes{
        {{"depth", &d.depth}, {"weight", &d.weight}, {"intensity", &d.intensity}, {"hit_logit", &d.hit_logit}, {"drop_logit", &d.drop_logit}}};
    std::vector<float> result(n_rays * kUpstreamFloats, 0.0f);
    for (std::size_t lane = 0; lane < lanes.size(); ++lane) {
        const auto& [name, values] = lanes[lane];
        if (values->empty()) continue;
        if (values->size() != n_rays) throw DataError(fmt::format("gradients of rendered {}: found {}, expected {}, one a ray, or none", name, values->size(), n_rays));
        for (std::size_t i = 0; i < n_rays; ++i) result[i * kUpstreamFloats + lane] = (*values)[i];
    }
    return result;
}

}  // namespace

struct DifferentiableRenderer::Impl {
    GradientOptions options;
    BackwardPass backward;
    std::optional<Gradients> gradients;   ///< none while surfels are added or removed
    Array<float> upstream;

    void make_gradients(Renderer& renderer) {
        gradients.emplace(renderer.stream().device(), renderer.scene(), options.wanted, room(renderer));
        gradients->zero_untouched = options.zero_untouched;
    }
};

DifferentiableRenderer::DifferentiableRenderer(Device& device, const Scene& scene, const ImageModel& model, const RendererOptions& options, const GradientOptions& gradients)
    : Renderer(device, scene, model, options),
      impl_(new Impl{gradients,
                     BackwardPass(device, model, accel().proxy(), options.trace, gradients.sums),
                     std::nullopt,
                     {device, std::size_t(options.n_rays) * kUpstreamFloats, "loss gradients"}}) {
    impl_->make_gradients(*this);
}

DifferentiableRenderer::~DifferentiableRenderer() = default;

RenderedBatch DifferentiableRenderer::batch() {
    Device& device = stream().device();
    const std::size_t n_rays = room(*this);
    if (impl_->upstream.size() < n_rays * kUpstreamFloats) {   // the renderer has made room for more rays
        stream().finish();
        impl_->upstream = Array<float>(device, n_rays * kUpstreamFloats, "loss gradients");
        if (impl_->options.wanted.rays) impl_->gradients->rays = Array<float>(device, 6 * n_rays, "ray gradient");
    }
    RenderedBatch result = rendered();
    result.upstream = &impl_->upstream;
    return result;
}

void DifferentiableRenderer::record_backward() {
    impl_->backward.set_sh_degree(model().sh_degree);
    impl_->backward.run(stream(), scene(), accel(), batch(), view_origin_m(), *impl_->gradients);   // Eq. 9
}

HostGradients DifferentiableRenderer::backward(const RenderedGradients& d_rendered) {
    const RenderedBatch last = batch();
    const std::size_t n_rays = last.rays.n_rays;
    if (last.rays.rays == nullptr) throw UsageError("gradients of a rendering: found none, expected forward() first");
    stream().finish();
    impl_->upstream.upload(interleaved(d_rendered, n_rays));
    if (last.geometry) stream().fill(last.geometry->gradient);
    record_backward();
    stream().finish();
    const Gradients& g = *impl_->gradients;
    return {g.surfels.download(), g.touched.download(scene().size()), g.poses.size() ? g.poses.download() : std::vector<float>{}, g.sensor.size() ? g.sensor.download() : std::vector<float>{},
            g.rays.size() ? g.rays.download(6 * n_rays) : std::vector<float>{}};
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
