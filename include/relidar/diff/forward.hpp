// SPDX-License-Identifier: Apache-2.0
// Forward pass of the renderer. It renders range, intensity and ray-drop logits of rays
// (paper, Eq. 2-4).
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/diff/accel.hpp>
#include <relidar/diff/traversal.hpp>
#include <relidar/gpu/stream.hpp>
#include <relidar/scene/device_scene.hpp>

namespace relidar {

struct RenderedRayValues {
    /// Sums over the hits of a ray, [n]: depth, weight, intensity, hit_logit, drop_logit.
    /// The softmax of the logits is the drop probability. See blended_values.h.
#define RELIDAR_VALUES(name, built, value, input, slope, meaning) std::vector<float> name;
    RELIDAR_IMAGE_VALUES(RELIDAR_VALUES)
#undef RELIDAR_VALUES
    std::vector<float> transmittance;  ///< Transmittance T after the last blended surfel.
    /// Distance t at which the transmittance T crosses 0.5, metres. 0 if T stays above
    /// 0.5.
    std::vector<float> median_depth;
    std::vector<std::uint32_t> hits;  ///< Number of blended surfels.
    /// Object that the ray hits, as an index into Scene::instances. -1 without hits. It
    /// is the object of the surfel at which the transmittance falls below 0.5, so a faint
    /// surfel in front does not count. If the transmittance stays above 0.5, it is the
    /// object of the nearest blended surfel.
    std::vector<std::int32_t> instance;
    /// Sum of w n over the hits, world frame. w is the weight of a hit, and n is the unit
    /// normal that faces the sensor. Empty if TraceOptions::normals is false.
    std::vector<glm::vec3> normal;
    /// Consecutive hits at most TraceOptions::mode_gap_m apart form a surface. This is
    /// the mean distance, metres, of the surface with the largest sum of blending
    /// weights. 0 without hits. Empty if mode_gap_m is not set.
    std::vector<float> mode_depth;
    std::size_t size() const { return depth.size(); }
};

/// Runs the forward kernel with fixed settings. The rendered rays stay on the device.
class ForwardPass {
public:
    ForwardPass(Device& device, const ImageModel& model, ProxyShape proxy, const TraceOptions& options);
    ~ForwardPass();
    /// Records GPU commands that trace and render a batch. Before this call, the same
    /// stream must contain two steps:
    /// DeviceScene::activate(), and an update of the
    /// acceleration structure.
    /// @param rendered_rays  output, [>= n_rays]
    /// @param stored_hits  output: hits for the backward pass of the same batch. Null =
    /// the backward pass traces the rays again
    /// @param surfaces  output, [>= n_rays], required if
    /// TraceOptions::writes_surfaces()
    void record_forward(Stream& stream, const DeviceScene& scene, const AccelerationStructure& accel,
                        const RayBatch& batch, Array<shared::RenderedRay>& rendered_rays,
                        StoredRayHits* stored_hits = nullptr,
                        const Array<shared::RenderedSurface>* surfaces = nullptr);
    /// Returns the number of rays since the last call that had too many hits to be traced
    /// completely. Such rays end too early, so the image is wrong. Waits for the GPU.
    std::uint32_t consume_truncated();
    /// Number of rays that had too many hits to be traced completely, [1] on the device.
    /// The count grows until the caller sets it to 0. The host can copy it without
    /// waiting.
    const Array<std::uint32_t>& n_truncated_rays() const;
    /// Number of rays with more hits than are stored for the backward pass, [1] on the
    /// device. The count grows until the caller sets it to 0.
    const Array<std::uint32_t>& n_overflowed_rays() const;
    void set_sh_degree(int degree);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Converts rendered rays to host arrays, one per value.
/// @param surfaces one entry per ray, or empty
RenderedRayValues to_ray_values(const std::vector<shared::RenderedRay>& rays,
                                const std::vector<shared::RenderedSurface>& surfaces = {});

struct RendererOptions {
    AccelOptions accel{};
    TraceOptions trace{};
    /// Number of rays for which memory is allocated at the start. If a batch has more
    /// rays, the renderer waits for the GPU once and allocates more memory.
    std::uint32_t n_rays = 0;
    /// Number of hits per ray that are kept for a backward pass, 16 bytes each. With 0,
    /// the backward pass traces every ray again. The renderer keeps fewer hits if device
    /// memory is exhausted.
    std::uint32_t keep_hits = 0;
    /// Stream to use. The stream must outlive the renderer. Several renderers may share a
    /// stream. Null = the renderer creates a private stream.
    Stream* stream = nullptr;
};

/// Renders one scene on one device. Contains the parameters, the acceleration structure
/// and the rendered rays. Call update() first, then render_rays() or record_forward() any
/// number of times. The device must outlive the renderer. Only one thread at a time may
/// use a renderer. Several renderers on one device are independent.
class Renderer {
public:
    /// Creates a renderer.
    /// @param scene is copied to the device. Later changes of parameters affect only the
    /// copy.
    /// @throws DataError if models or instances of the scene are out of range
    Renderer(Device& device, const Scene& scene, const ImageModel& model, const RendererOptions& o = {});
    ~Renderer();

    /// Records GPU commands that set the poses of all instances, compute view-dependent
    /// values, and update the acceleration structure. Must be called again after poses,
    /// view or parameters have changed. It affects only commands that are recorded later.
    /// @param instance_poses [instances] world_from_model of each instance, in the order
    /// of Scene::instances. Instance 0 is the background.
    /// @param view_origin_m [3] sensor position in the world frame, the origin of SH
    /// directions with ShDirection::surfel
    /// @throws DataError if the number of poses is wrong
    /// @throws UsageError if the image model and the scene have different primitives
    void update(const std::vector<InstancePose>& instance_poses, const glm::vec3& view_origin_m);
    /// Records GPU commands that prepare rendering with the current parameters from a new
    /// sensor position. All instances keep their poses. If no poses were set before, all
    /// instances are at the origin.
    void update(const glm::vec3& view_origin_m) { update(scene().poses(), view_origin_m); }
    /// Records GPU commands that set the sensor position and the poses of all instances.
    /// Faster than update(), because it does not update the ray-tracing trees of rigid
    /// models. Must not be used if a surfel parameter has changed since the last call of
    /// one of the two functions. If neither was called before, does the same as update().
    void record_poses(const std::vector<InstancePose>& instance_poses, const glm::vec3& view_origin_m);

    /// Renders rays and waits for the result.
    /// @param rays [n] world frame, directions of length 1
    /// @throws UsageError if update() was not called before
    /// @throws DeviceError if a ray has too many hits to be traced completely
    RenderedRayValues render_rays(const WorldRays& rays);
    /// Records GPU commands that render rays on the device. The ray array must stay valid
    /// until the stream has finished. After that, last_batch() contains the results.
    void record_forward(const RayBatch& rays);
    /// Returns the last rendered batch. Its pointer to the rays is null before the first
    /// batch is rendered. Its pointer to gradients (`upstream`) is always null.
    const RenderedBatch& last_batch() const;
    /// Waits for the GPU and returns the rendered values of the last batch as host
    /// arrays.
    /// @throws DeviceError if a ray had too many hits to be traced completely
    RenderedRayValues download_rays();
    /// Waits for the GPU and checks that all rays since the last call were traced
    /// completely.
    /// @throws DeviceError if a ray had too many hits and therefore ended too early
    void check_truncation();

    /// Returns the number of hits per ray that are kept for the backward pass.
    std::uint32_t stored_hits_per_ray() const;
    /// Sets the number of hits per ray that are kept for the backward pass. The number
    /// applies from the next record_forward(). Waits until the stream is idle.
    /// @throws OutOfDeviceMemory if the device does not have enough memory. The number is
    /// then unchanged.
    void set_stored_hits(std::uint32_t hits_per_ray);

    /// Sets the degree of the spherical harmonics (SH). The degree cannot exceed the
    /// degree of the image model. The caller must call update() next.
    void set_sh_degree(int degree);
    const ImageModel& model() const;  ///< Image model with the active SH degree.
    /// Replaces all surfel parameters on the device. Waits until the copy is complete.
    /// @throws DataError if the number of surfels or the primitive differs
    void upload_surfels(const Surfels& surfels);
    /// Waits for the GPU and returns the scene with its current parameters.
    Scene download_scene();

    /// Adds a model at the end of the scene without rebuilding the other models. Waits
    /// for the GPU. The memory grows in large steps, so that few calls copy the scene.
    /// @param added  scene with only this model and an instance of it
    /// @return index of the model
    /// @throws DataError if the scenes have different primitives, or if only `added` has
    /// gaits
    /// @throws OutOfDeviceMemory if memory is exhausted. The model may then be in the
    /// scene without an instance, and the next update() builds all trees again.
    std::uint32_t append_model(const Scene& added);
    /// Adds an instance, which is absent until update() or record_poses() places it.
    /// Waits for the GPU.
    /// @return index of the instance
    std::uint32_t append_instance(const ModelInstance& instance);

    /// Waits until the device no longer uses the arrays of the renderer. Ignores errors,
    /// so that destructors can call this function.
    void wait_for_device() noexcept;
    Stream& stream();
    DeviceScene& scene();
    const DeviceScene& scene() const;
    AccelerationStructure& accel();
    const ForwardPass& forward_pass() const;
    /// Returns the view origin of the last update() or record_poses(), in metres.
    const glm::vec3& view_origin_m() const;

    /// Releases the acceleration structure. Must be called before surfels are added or
    /// removed. create_accel() creates a new acceleration structure afterwards.
    void release_accel();
    void create_accel();

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
