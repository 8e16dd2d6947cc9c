// SPDX-License-Identifier: Apache-2.0
// Rays in, rendered range, intensity and ray-drop logits out (Eq. 2-4).
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/stages/accel.hpp>
#include <relidar/stages/gpu.hpp>
#include <relidar/stages/scene.hpp>
#include <relidar/stages/traversal.hpp>

namespace relidar {

/// What a ray brings back; one entry a ray.
struct Rendering {
    std::vector<float> depth;          ///< D = sum w t, not normalised, metres
    std::vector<float> weight;         ///< W = sum w
    std::vector<float> intensity;      ///< sum w * intensity
    std::vector<float> hit_logit;      ///< sum w * hit logit
    std::vector<float> drop_logit;     ///< sum w * drop logit + T * 1 (background)
    std::vector<float> transmittance;  ///< T after the last blended surfel
    std::vector<float> median_depth;   ///< t at which T crosses 0.5, 0 where it never does, metres
    std::vector<std::uint32_t> hits;   ///< blended surfels
    /// Whose surface a ray meets, an index into Scene::instances: that of the surfel at which T crosses 0.5, since a faint surfel
    /// before it would give its own name to what is seen through it; where T stays above, of the nearest blended one; -1 without a hit.
    std::vector<std::int32_t> instance;
    std::vector<glm::vec3> normal;     ///< sum w n of unit normals that face the sensor, world; empty without TraceOptions::geometry
    std::size_t size() const { return depth.size(); }
};

/// The forward kernel with its settings. Rendered rays stay on the device.
class ForwardPass {
public:
    ForwardPass(Device& device, const ImageModel& model, Proxy proxy, const TraceOptions& options);
    ~ForwardPass();
    /// Records the trace of a batch. The scene must be activated and accel updated before, in the same stream.
    /// @param rendered  [>= n_rays] output
    /// @param kept      output, for the backward pass of the same batch; null where it shall cast the rays again
    /// @param geometry  output, with TraceOptions::geometry
    void run(Stream& stream, const DeviceScene& scene, const Accel& accel, const RayBatch& batch, Array<shared::RenderedRay>& rendered,
             KeptHits* kept = nullptr, RayGeometry* geometry = nullptr);
    /// Rays that reached the cap of passes since the last call (they end early, which is an error). Blocks.
    std::uint32_t take_pass_cap_count();
    /// [1] The same on the device, counting until it is set to 0: to be read back without a wait.
    const Array<std::uint32_t>& pass_cap_count() const;
    void set_sh_degree(int degree);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Rendered rays as host arrays. @param geometry  of as many rays, where it was rendered
Rendering to_rendering(const std::vector<shared::RenderedRay>& rays, const std::vector<shared::RenderedGeometry>& geometry = {});

/// A scene ready to be traced: parameters on the device, records, acceleration structure, forward kernel.
class Renderer {
public:
    Renderer(Device& device, const Scene& scene, const ImageModel& model, const AccelOptions& accel = {}, const TraceOptions& trace = {});
    ~Renderer();
    /// Poses of all instances, world_from_model. Takes effect with the next trace.
    void set_poses(const std::vector<Pose>& world_from_instance);
    void place(const std::vector<InstancePose>& placed);
    /// @param view_origin_m  where SH directions start with ShDirection::surfel: the sensor's position
    /// @throws DeviceError where a ray reaches the cap of passes
    Rendering trace(const WorldRays& rays, const glm::vec3& view_origin_m);
    const KernelTimes& times() const;
    void reset_times();

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
