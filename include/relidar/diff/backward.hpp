// SPDX-License-Identifier: Apache-2.0
// Backward pass of the renderer. It traces the rays of a batch again, front to back, and
// computes the gradient of every parameter (paper, Eq. 9).
#pragma once

#include <cstdint>
#include <memory>
#include <optional>

#include <relidar/diff/accel.hpp>
#include <relidar/diff/traversal.hpp>
#include <relidar/gpu/stream.hpp>
#include <relidar/scene/device_scene.hpp>

namespace relidar {

namespace shared {
struct DeviceRayGradients;
struct InstancePoseGradients;
struct SensorPoseGradient;
}  // namespace shared

/// Selects optional gradients. Gradients of the surfels are always computed.
struct GradientSelection {
    bool rays = false;   ///< If true, computes dL/d(origin) and dL/d(direction) of every ray.
    bool poses = false;  ///< If true, computes the pose gradients of all instances and of the sensor.
};

/// Gradients of the loss with respect to surfel parameters, rays, poses of instances and
/// pose of the sensor.
struct DeviceGradients {
    SurfelArrays surfels;  ///< dL/d(parameter) of every surfel, in the layout of Surfels.
    /// Gradients with respect to the surfel records, [DeviceScene::count_rows(),16]. A
    /// surfel record is the 16 floats that tracing kernels read for one surfel.
    Array<float, shared::RecordGradients> records;
    /// Flags, [n]: 1 for each surfel that gets a gradient from this batch, otherwise 0.
    Array<std::uint32_t, shared::TouchedSurfels> touched;
    /// If true, surfels that get no gradient from this batch have gradients of zero. If
    /// false, their gradients are undefined, and the Adam optimiser treats them as zero.
    bool zero_untouched = true;
    /// dL/d(origin) and dL/d(direction) of every ray, [n_rays,6], world frame. Empty if
    /// GradientSelection::rays is false.
    Array<float, shared::DeviceRayGradients> rays;

    /// Pose gradients of the instances, [instances,6]: dL/d(v, w) at 0, with a
    /// translation v (m) and a rotation w (rad) in world axes. world_from_model = (R, T)
    /// becomes (exp([w]x) R, T + v). Row 0 (the background) is never refined. A row is
    /// exactly 0 if no ray with a gradient hits the instance. With ShDirection::surfel,
    /// SH directions contribute only to the first instance of a model. Empty if
    /// GradientSelection::poses is false. For an instance that moves during the sweep,
    /// P(t) becomes P(t) * (exp([R^T w]x), R^T v), with the rotation R of the pose that
    /// was set. The gradient does not describe a change of velocity.
    Array<float, shared::InstancePoseGradients> poses;
    /// Pose gradient of the sensor, [6]: dL/d(v, w) at 0. All rays of the batch move as
    /// one rigid body: origin' = c + exp([w]x) (origin - c) + v, direction' = exp([w]x)
    /// direction, with c = view_origin_m. Empty if GradientSelection::poses is false.
    /// Exact if no instance moves during the sweep. A moving instance is treated as if it
    /// had the pose that was set: v stays exact if it does not turn. The gradients in
    /// `rays` are always exact.
    Array<float, shared::SensorPoseGradient> sensor;

    /// Allocates the gradient arrays on the device.
    /// @param n_rays number of rays of the largest batch
    DeviceGradients(Device& device, const DeviceScene& scene, const GradientSelection& selection = {},
                    std::uint32_t n_rays = 0);
    ~DeviceGradients();
    DeviceGradients(DeviceGradients&&) noexcept;
    DeviceGradients& operator=(DeviceGradients&&) noexcept;

    struct PoseGradientSums;
    std::unique_ptr<PoseGradientSums> pose_sums;  ///< Scratch buffers for the pose gradients.
};

/// Method for summing the gradients of all hits of a surfel.
///
///   atomics    Each hit adds its gradient atomically to the sum of the surfel. The order
///              of the additions, and thus the last digits, differ between runs.
///   gather     Each hit writes a record. The records are sorted by surfel and summed
///              in ray order. Runs on one device are bit-equal if all records fit and
///              no model has more than two instances.
///   automatic  Uses the faster method for the device.
enum class GradientReduction { automatic, atomics, gather };

struct BackwardOptions {
    GradientReduction reduction = GradientReduction::automatic;
    /// Used only with GradientReduction::atomics. If true, threads first collect
    /// gradients in shared memory, so that neighbouring threads then add to neighbouring
    /// floats. Default: true on GPUs that guarantee the reconvergence of subgroups.
    std::optional<bool> coalesced_atomics = std::nullopt;
    /// Used only with GradientReduction::gather. Memory is allocated for this number of
    /// hits per ray of the largest batch. A hit needs 38 bytes (50 with
    /// ShDirection::ray).
    std::uint32_t hits_per_ray = 64;
};

class BackwardPass {
public:
    /// @throws UsageError if hits_per_ray is out of range
    BackwardPass(Device& device, const ImageModel& model, ProxyShape proxy, const TraceOptions& options,
                 const BackwardOptions& backward = {});
    ~BackwardPass();
    /// Records GPU commands that compute the gradients of all parameters for the rays of
    /// a batch. The commands overwrite all arrays in `gradients`.
    /// @param view_origin_m position of the sensor that was passed to the last
    /// DeviceScene::activate(), [3] world frame
    void record_backward(Stream& stream, DeviceScene& scene, const AccelerationStructure& accel,
                         const RenderedBatch& batch, const glm::vec3& view_origin_m,
                         DeviceGradients& gradients);
    void set_sh_degree(int degree);
    /// Returns a device array with one element: the largest number of hits of any batch
    /// so far. The caller may reset it to 0. Null with GradientReduction::atomics. If a
    /// batch has more hits than hit_capacity(), the gradients of the additional hits
    /// are summed with atomics. Then two runs are not bit-equal.
    const Array<std::uint32_t>* max_hit_count() const;
    std::uint64_t hit_capacity() const;
    /// Allocates memory for at least n_hits hits of a batch. Waits until the stream is
    /// idle.
    void reserve_hits(Stream& stream, std::uint64_t n_hits);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
