// SPDX-License-Identifier: Apache-2.0
// Rays in, rendered range, intensity and ray-drop logits out (Eq. 2-4).
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

/// What a ray brings back; one entry a ray.
struct Rendering {
    /// depth, weight, intensity, hit_logit and drop_logit: <relidar/diff/blended_values.h>
    /// says what each one is.
#define RELIDAR_VALUES(name, built, value, input, slope, meaning) std::vector<float> name;
    RELIDAR_IMAGE_VALUES(RELIDAR_VALUES)
#undef RELIDAR_VALUES
    std::vector<float> transmittance;  ///< T after the last blended surfel
    std::vector<float> median_depth;   ///< t at which T crosses 0.5, 0 where it never does, metres
    std::vector<std::uint32_t> hits;   ///< blended surfels
    /// Whose surface a ray meets, an index into Scene::instances: that of the surfel at
    /// which T crosses 0.5, since a faint surfel before it would give its own name to
    /// what is seen through it; where T stays above, of the nearest blended one; -1
    /// without a hit.
    std::vector<std::int32_t> instance;
    /// sum w n of unit normals that face the sensor, world; empty without
    /// TraceOptions::normals
    std::vector<glm::vec3> normal;
    /// mean t of the heaviest surface, 0 without hits, metres; empty without
    /// TraceOptions::mode_gap_m
    std::vector<float> mode_depth;
    std::size_t size() const { return depth.size(); }
};

/// The forward kernel with its settings. Rendered rays stay on the device.
class ForwardPass {
public:
    ForwardPass(Device& device, const ImageModel& model, Proxy proxy, const TraceOptions& options);
    ~ForwardPass();
    /// Records the trace of a batch. The scene must be activated and accel updated
    /// before, in the same stream.
    /// @param rendered  [>= n_rays] output
    /// @param kept      output, for the backward pass of the same batch; null where it
    /// shall cast the rays again
    /// @param surfaces  [>= n_rays] output, needed with TraceOptions::has_surfaces()
    void run(Stream& stream, const DeviceScene& scene, const Accel& accel, const RayBatch& batch,
             Array<shared::RenderedRay>& rendered, KeptHits* kept = nullptr,
             const Array<shared::RenderedSurface>* surfaces = nullptr);
    /// Rays that reached the cap of passes since the last call (they end early, which is
    /// an error). Blocks.
    std::uint32_t take_pass_cap_count();
    /// [1] The same on the device, counting until it is set to 0: to be read back without
    /// a wait.
    const Array<std::uint32_t>& pass_cap_count() const;
    /// [1] Rays with more hits than were kept of them, on the device, counting until it
    /// is set to 0.
    const Array<std::uint32_t>& overfull_count() const;
    void set_sh_degree(int degree);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Returns rendered rays as host arrays. @param surfaces  of as many rays, or empty
Rendering to_rendering(const std::vector<shared::RenderedRay>& rays,
                       const std::vector<shared::RenderedSurface>& surfaces = {});

/// What a renderer is made with beside a scene and its image model.
struct RendererOptions {
    AccelOptions accel{};
    TraceOptions trace{};
    /// room for the largest batch; where one has more, the renderer waits once and makes
    /// room
    std::uint32_t n_rays = 0;
    /// first hits of a ray kept for a backward pass, 16 bytes each; 0 = it casts every
    /// ray again
    std::uint32_t keep_hits = 0;
    /// that another renderer has too, and which outlives this one; null: one of its own
    Stream* stream = nullptr;
};

/// A scene ready to be rendered: parameters, acceleration structure, forward pass and
/// what rays render, on one device and in one stream, its own or RendererOptions::stream.
/// place() first, then forward() or record_forward() as often as wanted. The device must
/// outlive it; one thread at a time may use it. Several renderers of one device do not
/// know of each other.
class Renderer {
public:
    /// @param scene  is copied to the device: parameters() and upload() change the copy
    /// @throws DataError where models or instances of the scene are out of range
    Renderer(Device& device, const Scene& scene, const ImageModel& model,
             const RendererOptions& options = {});
    ~Renderer();

    /// Where everything is: poses, parameters made ready for tracing as seen from there,
    /// and the structure refitted. To be called again whenever poses, the view or
    /// parameters have changed. Records; takes effect with what is recorded next.
    /// @param placed         [instances] world_from_model each, in the order of
    /// Scene::instances; instance 0 is the background
    /// @param view_origin_m  [3] world: the sensor's position, from which SH directions
    /// start with ShDirection::surfel
    /// @throws DataError for another number of poses, UsageError where the image model is
    /// for another primitive than the scene's
    void place(const std::vector<InstancePose>& placed, const glm::vec3& view_origin_m);
    /// The same with all instances where they are; before they are placed they stand at
    /// the origin. Records.
    void place(const glm::vec3& view_origin_m) { place(scene().poses(), view_origin_m); }
    /// As the first where no parameter has changed since the last place() or move(): the
    /// trees of the models stay as they are. The first call does all that place() does.
    /// Records.
    void move(const std::vector<InstancePose>& placed, const glm::vec3& view_origin_m);

    /// Renders rays. Blocks. @param rays [n] world, directions of length 1
    /// @throws UsageError before place(), DeviceError where a ray reaches the cap of
    /// passes
    Rendering forward(const WorldRays& rays);
    /// The same for rays on the device, which must stay there until the stream is done.
    /// Records: rendered() is there when the stream is.
    void record_forward(const RayBatch& rays);
    /// The last batch; its upstream is null, and before the first one so are its rays.
    const RenderedBatch& rendered() const;
    /// What the last batch rendered, on the host. Blocks. @throws DeviceError as
    /// check_passes()
    Rendering download_rendering();
    /// Blocks. @throws DeviceError where a ray has reached the cap of passes since the
    /// last call: it ended early
    void check_passes();

    /// First hits of a ray that are kept.
    std::uint32_t kept_hits() const;
    /// Keeps so many from the next record_forward() on. Waits for the stream. @return
    /// false where the device has no memory for them: then as many as before
    bool keep_hits(std::uint32_t per_ray);

    /// Active degree of the spherical harmonics, at most the image model's. To be
    /// followed by place().
    void set_sh_degree(int degree);
    const ImageModel& model() const;  ///< with the active degree
    /// Takes other values of all parameters, as many surfels as there are. Blocks.
    /// @throws DataError for another number or primitive
    void upload(const Surfels& surfels);
    /// The scene as it is now. Blocks.
    Scene download();

    /// What is recorded here comes after all that the renderer has recorded so far, and
    /// before what it records next.
    Stream& stream();
    DeviceScene& scene();
    const DeviceScene& scene() const;
    Accel& accel();
    const ForwardPass& forward_pass() const;
    const glm::vec3& view_origin_m() const;  ///< of the last place() or move()

protected:
    /// Lets go of the acceleration structure before surfels are added or removed, and
    /// makes one for those there are then.
    void release_accel();
    void make_accel();

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
