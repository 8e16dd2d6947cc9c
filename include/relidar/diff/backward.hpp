// SPDX-License-Identifier: Apache-2.0
// Backward pass: traces the rays of a batch again, front to back, and computes the
// gradient of every parameter (Eq. 9).
#pragma once

#include <cstdint>
#include <memory>
#include <optional>

#include <relidar/diff/accel.hpp>
#include <relidar/diff/traversal.hpp>
#include <relidar/gpu/stream.hpp>
#include <relidar/scene/device_scene.hpp>

namespace relidar {

// Content types of device arrays. Kernels use them to distinguish arrays of the same
// element type.
namespace shared {
struct DeviceRayGradients;
struct InstancePoseGradients;
struct SensorPoseGradient;
}  // namespace shared

/// Selects gradients to compute in addition to the gradients of the surfels.
struct WantedGradients {
    bool rays = false;   ///< If true, computes the gradients of every ray.
    bool poses = false;  ///< If true, computes the pose gradients of all instances and of the sensor.
};

/// Gradients of the loss with respect to all inputs of the rendered image.
struct Gradients {
    SurfelArrays surfels;  ///< dL/d(parameter), in the layout of Surfels.
    /// dL/d(record) of each placed surfel, [DeviceScene::gradient_rows,16].
    Array<float, shared::RecordGradients> records;
    /// 1 for each surfel with a gradient in this batch, [n].
    Array<std::uint32_t, shared::TouchedSurfels> touched;
    /// If false, parameter gradients of surfels without a gradient are undefined; Adam
    /// treats them as zero.
    bool zero_untouched = true;
    /// dL/d(origin) and dL/d(direction) of every ray, [n_rays,6], world frame. Empty
    /// unless selected.
    Array<float, shared::DeviceRayGradients> rays;

    /// Pose gradients of the instances, [instances,6]: dL/d(v, w) at 0, v in metres, w in
    /// radians, both in world axes. world_from_model becomes (exp([w]x) R, T + v), so w
    /// rotates the model about its origin. Row 0 belongs to the background, whose pose is
    /// never refined. A row is exactly 0 if the instance is absent or no ray with a
    /// gradient hits it. With ShDirection::surfel, only the first instance of a model
    /// receives the gradient through SH directions, because the model is viewed from it.
    /// Empty unless selected.
    ///
    /// An instance that moves during the sweep has the pose P(t) = (R(t), T(t)). R is the
    /// rotation of the pose that was set. The gradient is the exact derivative of one
    /// correction that moves the model by the same amount in its own axes at all times of
    /// the sweep: P(t) becomes P(t) * (exp([R^T w]x), R^T v). It is not the derivative of
    /// a change of velocity or turn rate.
    Array<float, shared::InstancePoseGradients> poses;
    /// Pose gradient of the sensor, [6]: dL/d(v, w) at 0. All rays of the batch move as
    /// one rigid body: origin' = c + exp([w]x) (origin - c) + v and direction' =
    /// exp([w]x) direction, where c = view_origin_m moves along. With a rolling shutter
    /// this is one correction for the full frame. Empty unless selected.
    ///
    /// The gradient is exact if no instance moves during the sweep. For a moving
    /// instance, the sum uses one pose for all its rays, the pose that was set. v is then
    /// still exact if the instance moves without turning. Otherwise the contribution of
    /// the instance has an error: it is rotated by the angle that the instance turns
    /// between that pose and each ray. In w, the distance travelled in that time adds
    /// another error. `rays` is exact in every case.
    Array<float, shared::SensorPoseGradient> sensor;

    /// Allocates the gradient arrays.
    /// @param n_rays number of rays of the largest batch
    Gradients(Device& device, const DeviceScene& scene, const WantedGradients& wanted = {},
              std::uint32_t n_rays = 0);
    ~Gradients();
    Gradients(Gradients&&) noexcept;
    Gradients& operator=(Gradients&&) noexcept;

    struct PoseSums;
    std::unique_ptr<PoseSums> pose_sums;  ///< Scratch buffers for the pose gradients.
};

/// Method for summing the gradients of hits.
///
///   atomics    each hit adds atomically to its surfel; the order and thus the last
///              digits differ between runs
///   gather     each hit writes a record; the records are sorted by surfel and summed in
///              ray order; bit-equal between runs on one device if all records fit and no
///              model has more than two instances
///   automatic  the method that measures best
enum class Reduction { automatic, atomics, gather };

struct BackwardOptions {
    Reduction reduction = Reduction::automatic;
    /// For atomics: if true, threads exchange their hits, so that neighbouring threads
    /// add the floats of one hit. Default: true on a GPU.
    std::optional<bool> coalesced_atomics = std::nullopt;
    /// For gather: capacity in records per ray of the largest batch. A record has 38
    /// bytes (50 with ShDirection::ray).
    std::uint32_t hits_per_ray = 64;
};

class BackwardPass {
public:
    /// Creates the kernels of the backward pass.
    /// @throws UsageError if hits_per_ray is out of range
    BackwardPass(Device& device, const ImageModel& model, Proxy proxy, const TraceOptions& options,
                 const BackwardOptions& backward = {});
    ~BackwardPass();
    /// Records the second trace and the chain rule to the parameters. Overwrites all
    /// gradients.
    /// @param view_origin_m origin with which the scene was activated
    void run(Stream& stream, DeviceScene& scene, const Accel& accel, const RenderedBatch& batch,
             const glm::vec3& view_origin_m, Gradients& gradients);
    void set_sh_degree(int degree);
    /// Usage and capacity of the hit records for the gather method. most_hits() returns a
    /// device array [1] with the largest number of hits of a batch; it grows until it is
    /// set to 0. hit_capacity() returns the current capacity. Hits beyond the capacity
    /// are added with atomics, which is correct but not bit-equal between runs. With
    /// atomics the functions return null and 0.
    const Array<std::uint32_t>* most_hits() const;
    std::uint64_t hit_capacity() const;
    /// Grows the capacity to at least n_hits records. Waits for the stream.
    void reserve_hits(Stream& stream, std::uint64_t n_hits);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
