// SPDX-License-Identifier: Apache-2.0
// The same rays cast again, front to back, for the gradient of every parameter (Eq. 9).
#pragma once

#include <cstdint>
#include <memory>

#include <relidar/accel.hpp>
#include <relidar/traversal.hpp>
#include <relidar/gpu.hpp>
#include <relidar/scene.hpp>

namespace relidar {

/// Gradients of everything the image depends on.
struct Gradients {
    SurfelArrays surfels;                ///< dL/d(parameter), layout of Surfels
    Array<float> records;                ///< [n,16] dL/d(record)
    Array<std::uint32_t> touched;        ///< [n] 1 where a surfel has a gradient in this batch
    bool zero_untouched = true;          ///< false: parameter gradients of the other surfels are left undefined (Adam skips them)
    Array<float> view_origin;            ///< [3] accumulated (ShDirection::surfel), frame of the model
    Array<float> rays;                   ///< [n_rays,6] dL/d(origin), dL/d(direction), world; empty unless asked for

    Gradients(Device& device, std::uint32_t n_surfels, std::uint32_t n_rays_with_gradient = 0);
};

/// A batch that has been rendered and compared.
struct RenderedBatch {
    RayBatch rays;
    const Array<float>* rendered = nullptr;   ///< [n_rays, kRenderedFloats] of ForwardPass::run with the same scene
    const Array<float>* upstream = nullptr;   ///< [n_rays, kUpstreamFloats] of ImageLoss::run
};

class BackwardPass {
public:
    BackwardPass(Device& device, const ImageModel& model, Proxy proxy, const TraceOptions& options);
    ~BackwardPass();
    /// Records the second cast and the chain rule to the parameters. All gradients are overwritten.
    /// @param view_origin_m  the one the scene was activated with
    void run(Stream& stream, DeviceScene& scene, const Accel& accel, const RenderedBatch& batch, const glm::vec3& view_origin_m, Gradients& gradients);
    void set_sh_degree(int degree);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
