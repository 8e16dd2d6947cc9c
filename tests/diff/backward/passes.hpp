// SPDX-License-Identifier: Apache-2.0
// Runs the forward and backward pass of a random scene on the device. The derivatives of
// the loss with respect to the image ("upstream gradients") are random.
#pragma once

#include <vector>

#include <glm/gtc/quaternion.hpp>

#include <relidar/diff/differentiable_renderer.hpp>

#include "../../support/device.hpp"
#include "../../support/gradient_check.hpp"
#include "../../support/pixel_gradients.hpp"
#include "../../support/random_scene.hpp"
#include "../../support/surfels.hpp"

namespace relidar::test {

/// Returns the rotation by |rotation_vector| radians about `rotation_vector`.
inline glm::dquat make_rotation_by(const glm::dvec3& rotation_vector) {
    return glm::length(rotation_vector) > 0.0
               ? glm::angleAxis(glm::length(rotation_vector), glm::normalize(rotation_vector))
               : glm::dquat(1.0, 0.0, 0.0, 0.0);
}

/// Returns options that trace boxes. A chunk (hits fetched together) has 4 hits with SH
/// along the ray, and 16 hits with SH along the surfel. All tests use these sizes,
/// because creating kernels takes most of the test time.
inline RendererOptions make_options(const ImageModel& model) {
    return {.accel = {.proxy = ProxyShape::boxes},
            .trace = {.chunk = model.sh_direction == ShDirection::ray ? 4 : 16}};
}

inline RendererOptions add_hit_room(RendererOptions options, std::size_t n_rays) {
    options.n_rays = std::uint32_t(n_rays);
    return options;
}

struct Passes {
    SceneAndPoses placed;
    DifferentiableRenderer differentiable;
    Renderer& renderer;  ///< the renderer of `differentiable`
    Array<DeviceRay> rays;
    Array<shared::DeviceTarget> targets;
    glm::vec3 view_origin;

    /// Creates the renderer and both passes.
    /// @param g [>= rays] derivatives of the loss with respect to all rendered rays,
    /// until a loss overwrites them
    Passes(Device& device, const ImageModel& model, const RandomScene& s,
           const std::vector<reference::PixelGradient>& g, const RendererOptions& options,
           const BackwardOptions& sums = {})
        : placed(to_scene(s.world)),
          differentiable(device, placed.scene, model, add_hit_room(options, s.rays.size()),
                         {.sums = sums, .requested_gradients = {.rays = true, .poses = true}}),
          renderer(differentiable.renderer()),
          rays(device, to_device_rays(to_world_rays(s.rays)), "rays"),
          targets(device, to_targets(s.rays), "targets"),
          view_origin(s.view_origin) {
        renderer.scene().upload_poses(placed.world_from_instance);
        std::vector<shared::RayGradient> u;
        for (std::size_t i = 0; i < s.rays.size(); ++i) {
            shared::RayGradient& d = u.emplace_back();
#define RELIDAR_COPY(name, built, value, input, slope, meaning) d.name = float(g[i].name);
            RELIDAR_BLENDED_VALUES(RELIDAR_COPY)
#undef RELIDAR_COPY
        }
        differentiable.last_batch().upstream->upload(u);
    }
    Passes(Device& device, const GradientProblem& p, const RendererOptions& options,
           const BackwardOptions& sums = {})
        : Passes(device, p.settings.image, p.scene, p.upstream, options, sums) {}

    RayBatch batch() const { return {&rays, 0, 1, std::uint32_t(rays.size()), 0, &targets}; }
    DeviceGradients& gradients() { return differentiable.gradients(); }
    void run_forward() {
        renderer.update(view_origin);
        renderer.record_forward(batch());
    }
    void run() {
        run_forward();
        differentiable.record_backward();
        renderer.stream().submit_and_wait();
    }
};

/// Hit records of the gather method; zeros with atomics.
struct GatheredHits {
    std::uint64_t most = 0;  ///< hits of the largest batch since the last readback
    std::uint64_t capacity = 0;
};
inline GatheredHits download_gathered_hits(Passes& passes) {
    const BackwardPass& backward = passes.differentiable.backward_pass();
    if (!backward.max_hit_count()) return {};
    const GatheredHits hits{backward.max_hit_count()->download()[0], backward.hit_capacity()};
    passes.renderer.stream().fill(*backward.max_hit_count());
    passes.renderer.stream().submit_and_wait();
    return hits;
}

template <class Vector>
std::vector<double> lanes(const Vector& v, int count) {
    std::vector<double> row;
    for (int k = 0; k < count; ++k) row.push_back(v[k]);
    return row;
}

/// Adds a row for each parameter group of each surfel. The SH coefficients of each
/// channel form a separate row.
inline void add_surfel_rows(GradientTable& table, const std::vector<reference::Surfel>& expected,
                            const Surfels& actual) {
    for (std::size_t i = 0; i < expected.size(); ++i) {
        table.add_row("mean", lanes(expected[i].mean, 3), lanes(actual.mean[i], 3));
        table.add_row("rotation", lanes(expected[i].rotation, 4), lanes(actual.rotation[i], 4));
        table.add_row("log_scale", lanes(expected[i].log_scale, 2), lanes(actual.log_scale[i], 2));
        if (expected[i].log_scale_w)
            table.add_row("log_scale_w", {*expected[i].log_scale_w}, {actual.log_scale_w[i]});
        table.add_row("opacity_logit", {expected[i].opacity_logit}, {actual.opacity_logit[i]});
        const char* names[] = {"sh intensity", "sh hit", "sh drop"};
        for (int c = 0; c < kShChannels; ++c)
            table.add_row(
                names[c], lanes(expected[i].sh.data() + c * kShCoefficients, kShCoefficients),
                lanes(actual.sh.data() + i * kShFloats + std::size_t(c * kShCoefficients), kShCoefficients));
    }
}

}  // namespace relidar::test
