// SPDX-License-Identifier: Apache-2.0
// Forward pass: renders range, intensity and ray-drop logits of rays (Eq. 2-4).
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

/// Rendered values, one entry per ray.
struct Rendering {
    /// Depth, weight, intensity, hit_logit and drop_logit.
    /// <relidar/diff/blended_values.h> explains each of them.
#define RELIDAR_VALUES(name, built, value, input, slope, meaning) std::vector<float> name;
    RELIDAR_IMAGE_VALUES(RELIDAR_VALUES)
#undef RELIDAR_VALUES
    std::vector<float> transmittance;  ///< Transmittance T after the last blended surfel.
    /// Distance t at which T crosses 0.5, metres; 0 if T stays above 0.5.
    std::vector<float> median_depth;
    std::vector<std::uint32_t> hits;  ///< Number of blended surfels.
    /// Index into Scene::instances of the surface that the ray hits. It is the instance
    /// of the surfel at which T crosses 0.5, so that a faint surfel in front does not
    /// hide it. If T stays above 0.5, it is the instance of the nearest blended surfel.
    /// -1 without hits.
    std::vector<std::int32_t> instance;
    /// Sum of w n, where n is a unit normal that faces the sensor, world frame. Empty
    /// without TraceOptions::normals.
    std::vector<glm::vec3> normal;
    /// Mean t of the heaviest surface, metres; 0 without hits. Empty without
    /// TraceOptions::mode_gap_m.
    std::vector<float> mode_depth;
    std::size_t size() const { return depth.size(); }
};

/// Forward kernel and its settings. The rendered rays stay on the device.
class ForwardPass {
public:
    ForwardPass(Device& device, const ImageModel& model, Proxy proxy, const TraceOptions& options);
    ~ForwardPass();
    /// Records the trace of a batch. The scene must be activated and accel updated
    /// before, in the same stream.
    /// @param rendered  [>= n_rays] output
    /// @param kept      output, for the backward pass of the same batch; null = the
    /// backward pass traces the rays again
    /// @param surfaces  [>= n_rays] output, needed with TraceOptions::has_surfaces()
    void run(Stream& stream, const DeviceScene& scene, const Accel& accel, const RayBatch& batch,
             Array<shared::RenderedRay>& rendered, KeptHits* kept = nullptr,
             const Array<shared::RenderedSurface>* surfaces = nullptr);
    /// Returns the number of rays that reached the maximum number of passes since the
    /// last call. Such rays end too early, which is an error. Blocks.
    std::uint32_t take_pass_cap_count();
    /// Number of rays that reached the maximum number of passes, [1] on the device. It
    /// grows until it is set to 0. Can be read back without waiting.
    const Array<std::uint32_t>& pass_cap_count() const;
    /// Number of rays with more hits than were kept, [1] on the device. It grows until it
    /// is set to 0.
    const Array<std::uint32_t>& overfull_count() const;
    void set_sh_degree(int degree);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Returns rendered rays as host arrays.
/// @param surfaces one entry per ray, or empty
Rendering to_rendering(const std::vector<shared::RenderedRay>& rays,
                       const std::vector<shared::RenderedSurface>& surfaces = {});

/// Options of a renderer, in addition to the scene and its image model.
struct RendererOptions {
    AccelOptions accel{};
    TraceOptions trace{};
    /// Initial capacity in rays. If a batch is larger, the renderer waits once and
    /// allocates more memory.
    std::uint32_t n_rays = 0;
    /// Number of hits per ray that are kept for a backward pass, 16 bytes each. 0 = the
    /// backward pass traces every ray again.
    std::uint32_t keep_hits = 0;
    /// Stream to use, which may be shared with other renderers and must outlive this one.
    /// Null = create a stream.
    Stream* stream = nullptr;
};

/// Renderer of one scene on one device. It has the parameters, the acceleration
/// structure, the forward pass and the rendered rays. It uses a private stream or
/// RendererOptions::stream. Call place() first, then forward() or record_forward() any
/// number of times. The device must outlive the renderer. One thread at a time may use
/// it. Several renderers on one device are independent.
class Renderer {
public:
    /// Creates a renderer.
    /// @param scene copied to the device; scene().parameters() and upload() change only
    /// the copy
    /// @throws DataError if models or instances of the scene are out of range
    Renderer(Device& device, const Scene& scene, const ImageModel& model,
             const RendererOptions& options = {});
    ~Renderer();

    /// Sets the poses of all instances, activates the parameters for this view, and
    /// updates the acceleration structure. Call it again after poses, view or parameters
    /// have changed. Only records commands, which affect later recorded commands.
    /// @param placed [instances] world_from_model of each, in the order of
    /// Scene::instances; instance 0 is the background
    /// @param view_origin_m [3] sensor position in the world frame, the origin of SH
    /// directions with ShDirection::surfel
    /// @throws DataError if the number of poses is wrong
    /// @throws UsageError if the image model and the scene have different primitives
    void place(const std::vector<InstancePose>& placed, const glm::vec3& view_origin_m);
    /// Updates parameters and view, and keeps the poses of all instances. Before poses
    /// are set, all instances are at the origin. Only records commands.
    void place(const glm::vec3& view_origin_m) { place(scene().poses(), view_origin_m); }
    /// Sets the poses of all instances like place(), but does not refit the trees of
    /// rigid models. Use it if no parameter has changed since the last place() or move().
    /// The first call does the same as place(). Only records commands.
    void move(const std::vector<InstancePose>& placed, const glm::vec3& view_origin_m);

    /// Renders rays. Blocks.
    /// @param rays [n] world frame, directions of length 1
    /// @throws UsageError if place() was not called before
    /// @throws DeviceError if a ray reaches the maximum number of passes
    Rendering forward(const WorldRays& rays);
    /// Records the rendering of rays on the device, which must stay valid until the
    /// stream is done. rendered() is then complete.
    void record_forward(const RayBatch& rays);
    /// Returns the last batch. Its upstream is null. Before the first batch, its rays are
    /// null too.
    const RenderedBatch& rendered() const;
    /// Returns the rendered values of the last batch on the host. Blocks.
    /// @throws DeviceError as check_passes()
    Rendering download_rendering();
    /// Checks that no ray has reached the maximum number of passes since the last call.
    /// Blocks.
    /// @throws DeviceError if a ray has reached it and therefore ended too early
    void check_passes();

    /// Number of hits that are kept for each ray.
    std::uint32_t kept_hits() const;
    /// Sets the number of hits that are kept for each ray, from the next record_forward()
    /// on. Waits for the stream.
    /// @return false if the device has not enough memory; the number is then unchanged
    bool keep_hits(std::uint32_t per_ray);

    /// Sets the active SH degree, limited by the degree of the image model. Call place()
    /// next.
    void set_sh_degree(int degree);
    const ImageModel& model() const;  ///< Image model with the active SH degree.
    /// Replaces the values of all parameters. Blocks.
    /// @throws DataError if the number of surfels or the primitive differs
    void upload(const Surfels& surfels);
    /// Returns the scene with its current parameters. Blocks.
    Scene download();

    /// Returns the stream of the renderer. Commands recorded in it are executed in order
    /// with those of the renderer.
    Stream& stream();
    DeviceScene& scene();
    const DeviceScene& scene() const;
    Accel& accel();
    const ForwardPass& forward_pass() const;
    const glm::vec3& view_origin_m() const;  ///< View origin of the last place() or move().

protected:
    /// Releases the acceleration structure before surfels are added or removed, and
    /// creates a new one afterwards.
    void release_accel();
    void make_accel();

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
