// SPDX-License-Identifier: Apache-2.0
// The whole chain from the parameters of a scene to what rays render, and back: what a
// training step stands on, here or elsewhere.
//   on the device  place(), record_forward(), losses into batch().upstream, record_backward(), Adam::step with gradients(): nothing waits
//   on the host    place(), forward(rays), backward(d_rendered): arrays in, arrays out, for a loss of one's own in any language
#pragma once

#include <functional>
#include <memory>
#include <vector>

#include <relidar/diff/backward.hpp>
#include <relidar/diff/forward.hpp>

namespace relidar {

/// How gradients are found, and of what.
struct GradientOptions {
    BackwardOptions sums{};
    WantedGradients wanted{};
    bool zero_untouched = true;  ///< see Gradients
};

/// dL/d(rendered) of every ray, one array for each of Rendering's that has a gradient. An
/// empty one stands for zeros.
struct RenderedGradients {
    /// [n] of depth (1/m), weight, intensity, hit_logit and drop_logit, as in Rendering
#define RELIDAR_VALUES(name, built, value, input, slope, meaning) std::vector<float> name{};
    RELIDAR_IMAGE_VALUES(RELIDAR_VALUES)
#undef RELIDAR_VALUES
};

/// Gradients as host arrays; what they mean is said in Gradients. Those that were not
/// asked for are empty.
struct HostGradients {
    /// [n] dL/d(parameter), each in the place of its parameter; 0 where no ray has met
    /// the surfel
    Surfels surfels;
    std::vector<std::uint32_t> touched;  ///< [n] 1 where a surfel has a gradient
    std::vector<float> poses;            ///< [instances, 6] dL/d(v, w), metres and radians, world axes
    std::vector<float> sensor;           ///< [6] the same of the sensor, all rays moving as one body
    std::vector<float> rays;             ///< [n_rays, 6] dL/d(origin), dL/d(direction), world
};

/// A Renderer whose image can be differentiated. The gradients are those of the last
/// batch rendered.
class DifferentiableRenderer : public Renderer {
public:
    /// @throws UsageError where gradients.sums is out of range, else as Renderer
    DifferentiableRenderer(Device& device, const Scene& scene, const ImageModel& model,
                           const RendererOptions& options = {}, const GradientOptions& gradients = {});
    ~DifferentiableRenderer();

    /// Gradients of a loss of the rays that forward() rendered last. Blocks. Poses, view
    /// and parameters must be as they were then.
    /// @param d_rendered  arrays of as many entries as there were rays, or empty
    /// @throws UsageError before forward(), DataError for another number of entries
    HostGradients backward(const RenderedGradients& d_rendered);

    /// The last batch with the places of its gradients, which losses fill between
    /// record_forward() and record_backward().
    RenderedBatch batch();
    /// Records the backward pass of the last batch: gradients() hold its gradients when
    /// the stream is done.
    void record_backward();
    Gradients& gradients();
    BackwardPass& backward_pass();

    /// Adds or removes surfels: what is sized by their number goes before `change` and
    /// comes back after it, for the size the scene has then. To be followed by place().
    /// Waits for the stream.
    /// @param change  is told how many bytes a surfel will be allocated again
    void change_surfels(const std::function<void(double others_bytes)>& change);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
