// SPDX-License-Identifier: Apache-2.0
// The same rays cast again, front to back, for the gradient of every parameter (Eq. 9).
#pragma once

#include <cstdint>
#include <memory>
#include <optional>

#include <relidar/diff/accel.hpp>
#include <relidar/diff/traversal.hpp>
#include <relidar/gpu/stream.hpp>
#include <relidar/scene/device_scene.hpp>

namespace relidar {

namespace shared {  // what arrays hold, as kernels tell them apart
struct DeviceRayGradients;
struct InstancePoseGradients;
struct SensorPoseGradient;
}  // namespace shared

/// What is wanted beside the gradients of the surfels.
struct WantedGradients {
    bool rays = false;   ///< of every ray
    bool poses = false;  ///< of all instances and of the sensor
};

/// Gradients of everything the image depends on.
struct Gradients {
    SurfelArrays surfels;  ///< dL/d(parameter), layout of Surfels
    /// [DeviceScene::gradient_rows,16] dL/d(record) of each placed surfel
    Array<float, shared::RecordGradients> records;
    /// [n] 1 where a surfel has a gradient in this batch
    Array<std::uint32_t, shared::TouchedSurfels> touched;
    /// false: parameter gradients of the other surfels are left undefined (Adam takes
    /// them for zero)
    bool zero_untouched = true;
    /// [n_rays,6] dL/d(origin), dL/d(direction), world; empty unless asked for
    Array<float, shared::DeviceRayGradients> rays;

    /// [instances,6] dL/d(v, w) at 0, v metres, w radians, both in the world's axes:
    /// world_from_model becomes (exp([w]x) R, T + v), so w turns the model about its own
    /// origin. Row 0 is the background's: a refinement keeps that where it is. Exactly 0
    /// for instances that no ray with a gradient meets, and for absent ones. With
    /// ShDirection::surfel a model is viewed from its first placement: further ones have
    /// no share in what its SH directions do. Empty unless asked for.
    ///
    /// An instance that moves during the sweep has the pose P(t) = (R(t), T(t)); R is its
    /// rotation in the pose that it was placed with. The gradient is the exact derivative
    /// of one correction that moves the model by the same amount in its own axes at all
    /// times of the sweep: P(t) becomes P(t) * (exp([R^T w]x), R^T v). It is not the
    /// derivative of a change of velocity or of turn rate.
    Array<float, shared::InstancePoseGradients> poses;
    /// [6] dL/d(v, w) at 0: every ray of the batch moves as one body, origin' = c +
    /// exp([w]x) (origin - c) + v and direction' = exp([w]x) direction, c =
    /// view_origin_m, which moves along. With a rolling shutter that is one correction
    /// for the whole frame. Empty unless asked for.
    ///
    /// It is the exact derivative if no instance moves during the sweep. For an instance
    /// that moves, the sum uses the pose that the instance was placed with for all its
    /// rays. So v is exact if the instance drives and does not turn. Otherwise the share
    /// of that instance is off by the angle that it turns, and in w also by its travel,
    /// between that pose and each ray. `rays` is exact in every case.
    Array<float, shared::SensorPoseGradient> sensor;

    /// @param n_rays  of the largest batch
    Gradients(Device& device, const DeviceScene& scene, const WantedGradients& wanted = {},
              std::uint32_t n_rays = 0);
    ~Gradients();
    Gradients(Gradients&&) noexcept;
    Gradients& operator=(Gradients&&) noexcept;

    struct PoseSums;
    std::unique_ptr<PoseSums> pose_sums;  ///< what poses and sensor are summed from
};

/// How the gradients of hits are summed.
///   atomics: each hit adds to its surfel, in whatever order the device runs them: the last digits differ from run to run
///   gather:  each hit leaves a record, the records are sorted by surfel and summed in the order of rays: bit-equal from run to run on
///            one device, as long as all records have room and no model is placed more than twice
///   automatic: what measures best
enum class Reduction { automatic, atomics, gather };

struct BackwardOptions {
    Reduction reduction = Reduction::automatic;
    /// atomics: threads exchange their hits, so that neighbours add the floats of one
    /// hit; not given: on a GPU
    std::optional<bool> coalesced_atomics = std::nullopt;
    /// gather: room for so many records a ray of the largest batch, 38 bytes each (50
    /// with ShDirection::ray)
    std::uint32_t hits_per_ray = 64;
};

class BackwardPass {
public:
    /// @throws UsageError where hits_per_ray is out of range
    BackwardPass(Device& device, const ImageModel& model, Proxy proxy, const TraceOptions& options,
                 const BackwardOptions& backward = {});
    ~BackwardPass();
    /// Records the second cast and the chain rule to the parameters. All gradients are
    /// overwritten.
    /// @param view_origin_m  the one the scene was activated with
    void run(Stream& stream, DeviceScene& scene, const Accel& accel, const RenderedBatch& batch,
             const glm::vec3& view_origin_m, Gradients& gradients);
    void set_sh_degree(int degree);
    /// Hit records of the gather: [1] of the largest batch, on the device, growing until
    /// it is set to 0; and the room that there is now. Hits beyond it are added with
    /// atomics: right, but not the same in every run. Null and 0 with atomics.
    const Array<std::uint32_t>* most_hits() const;
    std::uint64_t hit_capacity() const;
    /// Makes room for so many hit records, at least. Waits for the stream.
    void reserve_hits(Stream& stream, std::uint64_t n_hits);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
