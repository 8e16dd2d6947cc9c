// SPDX-License-Identifier: Apache-2.0
// Corrects the poses of the sensor and of the actors' boxes during training
// (train.refine_poses). The host updates the few poses in double precision, a fixed
// number of iterations later, so that it does not wait (kReadbackLag). A checkpoint
// includes the pending gradients.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <span>
#include <vector>

#include <relidar/gpu/stream.hpp>
#include <relidar/log/log.hpp>
#include <relidar/registration/registration.hpp>
#include <relidar/scene/scene.hpp>

#include "gpu/kernel.hpp"
#include "train/frames/batch.hpp"
#include "train/frames/frame_data.hpp"
#include "train/shared/train.h"

namespace relidar {

struct PoseStepRates {
    double rate_m = 0.0;
    double rate_rad = 0.0;
    double prior_per_m2 = 0.0;    ///< weight of the prior |v|^2
    double prior_per_rad2 = 0.0;  ///< weight of the prior |w|^2
};

class TrackCorrection {
public:
    /// @param unobserved  [poses] motions that the correction of each pose must not
    /// contain, or empty
    explicit TrackCorrection(PoseTrack track, std::vector<std::vector<UnobservedMotion>> unobserved = {});

    const PoseTrack& uncorrected_track() const { return track_; }
    /// Interpolates between the nearest optimised poses. Zero if no pose was optimised.
    Twist correction_at(std::size_t pose) const;
    PoseTrack corrected_track() const;

    /// Adds a loss gradient dL/d(v, w) of the pose at any time, or of a recorded pose.
    /// The next run_adam_step() uses the sum.
    void add_gradient(double t_s, const Twist& gradient);
    void add_gradient(std::size_t pose, double weight, const Twist& gradient);
    /// Performs an Adam step. Changes only poses that got a gradient after the last step.
    void run_adam_step(const PoseStepRates& step_rates);
    /// Removes the rigid motion that all corrections have in common, which the loss does
    /// not constrain. Afterwards, the mean translation and rotation are 0.
    void remove_mean_motion();

    template <class Visitor>
    void visit_state(const std::string& name, Visitor&& visit) {
        visit(name + "/correction", values_);
        visit(name + "/moment1", moment1_);
        visit(name + "/moment2", moment2_);
        visit(name + "/steps", n_steps_);
    }

private:
    PoseTrack track_;
    std::vector<std::vector<UnobservedMotion>> unobserved_;  ///< [poses] or empty
    std::vector<double> values_, moment1_, moment2_;         ///< [poses,6]
    std::vector<std::uint64_t> n_steps_;                     ///< [poses] number of steps
    std::vector<double> gradient_;  ///< [poses,6] sum of the gradients since the last step
    std::vector<bool> visited_;     ///< [poses] true if a gradient was added since the last step

    Twist stored_correction(std::size_t pose) const;
};

class PoseCorrectedRays {
public:
    PoseCorrectedRays(Device& device, const std::vector<TrainingFrameData>& frames);
    /// Moves the rays of a frame to the corrected poses. The frame must be on the device.
    /// Afterwards `frame` refers to the new rays, which are valid until the next call.
    void move_rays(Stream& stream, const TrackCorrection& correction, TrainingFrameData& frame);
    /// A ray contributes to the poses before and after its firing time. Ignores the
    /// effect of poses on the viewing direction of the spherical harmonics. Call
    /// move_rays() for the same frame before.
    void record_sums(Stream& stream, const TrainingFrameData& frame, const SampledBatch& batch,
                     const Array<float, shared::DeviceRayGradients>& ray_gradients);
    /// [kGroupsPerPose, max_knots_, 6] partial sums of the gradients of each pose
    const Array<float>& partial_sums() const { return partial_sums_; }
    /// Adds the partial sums on the host. Returns the gradient of each pose of a frame.
    std::vector<Twist> sum_gradients(std::span<const float> partial_sums, std::uint32_t n_knots) const;

private:
    /// workgroups per pose, so that the GPU has enough parallel work
    static constexpr std::uint32_t kGroupsPerPose = 16;

    std::uint32_t max_knots_;        ///< maximum number of poses ("knots") of a frame
    Array<DeviceRay> moved_;         ///< [maximum rays of a frame] rays of the frame of the last move_rays()
    Array<shared::PoseKnot> knots_;  ///< [max_knots_] poses of the same frame
    Array<float, shared::KnotGradientRows> partial_sums_;
    Kernel<shared::MoveRaysParams> move_;
    Kernel<shared::KnotGradientsParams> gradients_;
};

/// Copies an array from the device to the host in each iteration. The host reads a copy
/// at most kReadbackLag iterations later.
class DelayedReadback {
public:
    DelayedReadback(Device& device, std::size_t n_floats, const char* text);
    void record_copy(Stream& stream, const Buffer& source, int step);
    /// Waits for the copy of an iteration. Does nothing if `values` has it already.
    void read(Stream& stream, int step, std::vector<float>& values);
    std::size_t n_floats() const { return n_floats_; }

private:
    std::size_t n_floats_;
    std::vector<ReadbackBuffer> buffers_;  ///< [kReadbackLag]
};

/// An iteration whose pose gradients were not applied yet.
struct PendingPoseGradients {
    int step = 0;
    std::size_t frame = 0;  ///< index in the list of training frames
    /// [actors, 2] start and end of the time in which each actor was visible
    std::vector<double> actor_time_s;
    /// Gradients of the sensor poses, [kGroupsPerPose, max_knots_, 6], and of the actors,
    /// [instances, 6]. Empty while they are on the device, or if not needed.
    std::vector<float> of_sensor, of_instances;
};

class TrainingFrames;
struct DeviceGradients;
struct RefinedPoses;
struct TrainConfig;
struct GradientSelection;

class PoseRefiner {
public:
    /// @param layout  the tracks of its instances are corrected
    /// @param config  with train.refine_poses=none, all functions do nothing
    /// @param unobserved  motions of the vehicle that stay as they are, see
    /// find_unobserved_motions()
    PoseRefiner(Device& device, const Log& log, const Scene& layout, const TrainConfig& config,
                const TrainingFrames& frames, std::vector<std::vector<UnobservedMotion>> unobserved);

    bool is_enabled() const { return is_active_; }
    /// Returns which gradients the backward pass must compute for record_gradients().
    GradientSelection required_gradients() const;
    void move_frame(Stream& stream, TrainingFrameData& frame);
    /// Records the pose gradients of a batch and their copy to the host.
    /// @param step  counts from 1
    void record_gradients(Stream& stream, std::size_t frame_index, const TrainingFrameData& frame,
                          const SampledBatch& batch, const DeviceGradients& gradients, int step);
    /// Applies the gradients of pending iterations in order. Waits for them if necessary.
    void apply_until(Stream& stream, int last_step);
    /// Waits for the pending gradients, so that a checkpoint can store them.
    void wait_for_pending(Stream& stream);
    RefinedPoses refined_poses() const;

    template <class Visitor>
    void visit_state(Visitor&& visit) {
        if (!is_enabled()) return;
        if (sensor_) sensor_->visit_state("poses/sensor", visit);
        for (RefinedActor& actor : actors_)
            actor.correction.visit_state("poses/actor " + poses_.boxes[actor.box].id, visit);
        PendingArrays arrays = join_pending();
        visit("poses/coming/step", arrays.step);
        visit("poses/coming/frame", arrays.frame);
        visit("poses/coming/actor_time_s", arrays.actor_time_s);
        visit("poses/coming/gradient", arrays.gradient);
        split_pending(arrays);
    }
    void update_corrected();

private:
    struct RefinedActor {
        std::size_t instance;  ///< index of the instance in the scene
        std::size_t box;       ///< index of the box in the log
        TrackCorrection correction;
    };

    /// `pending_` in a checkpoint: one array for each member, with a row per iteration.
    struct PendingArrays {
        std::vector<std::uint64_t> step, frame;
        std::vector<double> actor_time_s;
        std::vector<float> gradient;  ///< of the sensor poses, then of the instances
    };

    const TrainConfig& config_;
    const bool is_active_;
    const TrainingFrames& frames_;
    Scene layout_;
    Log poses_;  ///< the log without its scans, with the current corrections
    std::optional<TrackCorrection> sensor_;
    std::optional<PoseCorrectedRays> rays_;
    std::vector<RefinedActor> actors_;
    std::deque<PendingPoseGradients> pending_;  ///< oldest first
    /// gradients on their way to the host; empty if these poses are not corrected
    std::optional<DelayedReadback> sensor_readback_, instance_readback_;

    PendingArrays join_pending() const;
    void split_pending(const PendingArrays& arrays);
    void read_gradients(Stream& stream, PendingPoseGradients& pending);
    void apply_gradients(const PendingPoseGradients& pending);
};

}  // namespace relidar
