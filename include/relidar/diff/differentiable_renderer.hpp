// SPDX-License-Identifier: Apache-2.0
// Differentiable renderer. It renders rays from the parameters of a scene, and it
// computes gradients of the parameters from gradients of the rendered rays. There are two
// ways to write a training step. On the device, no call waits for the GPU:
//   update() and record_forward() of renderer(), losses that write
//   last_batch().upstream, record_backward(), Adam::record_step().
// On the host, with arrays, for custom losses in any language:
//   update() and render_rays() of renderer(), then backpropagate().
#pragma once

#include <functional>
#include <memory>
#include <vector>

#include <relidar/diff/backward.hpp>
#include <relidar/diff/forward.hpp>

namespace relidar {

struct GradientOptions {
    BackwardOptions sums{};
    GradientSelection requested_gradients{};
    bool zero_untouched = true;
};

/// Gradients of the loss with respect to the rendered values of every ray. Each
/// differentiable array of RenderedRayValues has an array here. An empty array means
/// gradients of zero.
struct RenderedGradients {
    /// Gradients with respect to depth (1/m), weight, intensity, hit_logit and drop_logit
    /// of each ray, [n].
#define RELIDAR_VALUES(name, built, value, input, slope, meaning) std::vector<float> name{};
    RELIDAR_IMAGE_VALUES(RELIDAR_VALUES)
#undef RELIDAR_VALUES
};

/// Gradients as host arrays, with the same meaning as the device arrays in
/// `DeviceGradients`. Gradients that were not selected have empty arrays.
struct HostGradients {
    /// Gradients of a loss L instead of parameters: `mean` holds dL/d(mean) of each
    /// surfel, and so on. They are 0 for a surfel that no ray has hit.
    Surfels surfels;
    std::vector<std::uint32_t> touched;  ///< Flags, [n]: 1 for each surfel with a gradient.
    std::vector<float> poses;
    std::vector<float> sensor;
    std::vector<float> rays;
};

/// Computes gradients with a renderer. The gradients belong to the batch that the
/// renderer rendered last.
class DifferentiableRenderer {
public:
    /// @throws UsageError if an option in gradients.sums is out of range
    /// @throws errors of the Renderer constructor
    DifferentiableRenderer(Device& device, const Scene& scene, const ImageModel& model,
                           const RendererOptions& options = {}, const GradientOptions& gradients = {});
    ~DifferentiableRenderer();

    Renderer& renderer();
    const Renderer& renderer() const;

    /// Computes the gradients of a loss over the rays that Renderer::render_rays()
    /// rendered last. Waits for the GPU. Poses, view and parameters must be unchanged
    /// since then.
    /// @param rendered_gradients dL/d(rendered), one entry per ray, or empty arrays
    /// @throws UsageError if nothing was rendered before
    /// @throws DataError if an array has the wrong number of entries
    HostGradients backpropagate(const RenderedGradients& rendered_gradients);

    /// Returns the last rendered batch together with the arrays for its gradients.
    /// Between record_forward() and record_backward(), losses write
    /// dL/d(rendered) to the array `upstream`.
    RenderedBatch last_batch();
    /// Records the GPU commands of the backward pass for the last batch. gradients()
    /// contains the results when the stream has finished.
    void record_backward();
    DeviceGradients& gradients();
    BackwardPass& backward_pass();

    /// Calls `change_surfels`, which adds or removes surfels. Waits until the stream is
    /// idle, frees all memory that depends on the number of surfels, and allocates it
    /// again afterwards. The caller must call Renderer::update() next.
    /// @param change_surfels receives the bytes per surfel that will be allocated again
    void resize(const std::function<void(double reserved_bytes_per_surfel)>& change_surfels);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
