// SPDX-License-Identifier: Apache-2.0
// Differentiable renderer: computes rendered rays from the parameters of a scene, and
// gradients of the parameters from gradients of the rendered rays. Training steps use it.
//
//   on the device  place(), record_forward(), losses write batch().upstream,
//                  record_backward(), Adam::step with gradients(); nothing blocks
//   on the host    place(), forward(rays), backward(d_rendered): host arrays in and out,
//                  for custom losses in any language
#pragma once

#include <functional>
#include <memory>
#include <vector>

#include <relidar/diff/backward.hpp>
#include <relidar/diff/forward.hpp>

namespace relidar {

/// Selects gradients and the method of summing them.
struct GradientOptions {
    BackwardOptions sums{};
    WantedGradients wanted{};
    bool zero_untouched = true;  ///< If false, gradients of surfels without a gradient are undefined.
};

/// dL/d(rendered) of every ray, one array for each differentiable array of Rendering. An
/// empty array means zeros.
struct RenderedGradients {
    /// [n] gradients with respect to depth (1/m), weight, intensity, hit_logit and
    /// drop_logit, as in Rendering.
#define RELIDAR_VALUES(name, built, value, input, slope, meaning) std::vector<float> name{};
    RELIDAR_IMAGE_VALUES(RELIDAR_VALUES)
#undef RELIDAR_VALUES
};

/// Gradients as host arrays; struct Gradients explains their meaning. Arrays that were
/// not selected are empty.
struct HostGradients {
    /// dL/d(parameter), [n], stored in the field of each parameter; 0 if no ray has hit
    /// the surfel.
    Surfels surfels;
    std::vector<std::uint32_t> touched;  ///< 1 for each surfel with a gradient, [n].
    /// Pose gradients of the instances, [instances, 6]: dL/d(v, w), metres and radians,
    /// world axes.
    std::vector<float> poses;
    /// Pose gradient of the sensor, [6]: dL/d(v, w); all rays move as one rigid body.
    std::vector<float> sensor;
    /// dL/d(origin) and dL/d(direction) of every ray, [n_rays, 6], world frame.
    std::vector<float> rays;
};

/// Renderer whose image is differentiable. The gradients refer to the last rendered
/// batch.
class DifferentiableRenderer : public Renderer {
public:
    /// Creates the renderer and its gradient arrays.
    /// @throws UsageError if an option in gradients.sums is out of range
    /// @throws errors of the Renderer constructor
    DifferentiableRenderer(Device& device, const Scene& scene, const ImageModel& model,
                           const RendererOptions& options = {}, const GradientOptions& gradients = {});
    ~DifferentiableRenderer();

    /// Computes the gradients of a loss over the rays that forward() rendered last.
    /// Blocks. Poses, view and parameters must not have changed since then.
    /// @param d_rendered arrays with one entry per ray, or empty arrays
    /// @throws UsageError if forward() was not called before
    /// @throws DataError if an array has the wrong number of entries
    HostGradients backward(const RenderedGradients& d_rendered);

    /// Returns the last batch with the arrays for its gradients. Losses write these
    /// between record_forward() and record_backward().
    RenderedBatch batch();
    /// Records the backward pass of the last batch. gradients() contains the results when
    /// the stream is done.
    void record_backward();
    Gradients& gradients();
    BackwardPass& backward_pass();

    /// Adds or removes surfels. Releases all memory that depends on the number of surfels
    /// before it calls `change`, and allocates it for the new number afterwards. Call
    /// place() next. Waits for the stream.
    /// @param change receives the number of bytes per surfel that will be allocated again
    void change_surfels(const std::function<void(double others_bytes)>& change);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
