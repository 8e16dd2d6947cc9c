// SPDX-License-Identifier: Apache-2.0
// Corrects the poses of the sensor and of the actors' boxes during training
// (train.refine_poses). The host updates the few poses in double precision, a fixed
// number of iterations later, so that it does not wait (kReadbackLag). A checkpoint
// includes the pending gradients.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include <relidar/gpu/stream.hpp>
#include <relidar/log/sequence.hpp>
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
    explicit TrackCorrection(PoseTrack track);

    const PoseTrack& uncorrected_track() const { return track_; }
    /// Interpolates between the nearest optimised poses if the pose was not optimised
    /// yet. Zero if no pose was optimised.
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
    std::vector<double> values_, moment1_, moment2_;  ///< [poses,6]
    std::vector<std::uint64_t> n_steps_;              ///< [poses] number of steps
    std::vector<double> gradient_;                    ///< [poses,6] sum of the gradients since the last step
    std::vector<bool> visited_;  ///< [poses] true if a gradient was added since the last step

    Twist stored_correction(std::size_t pose) const;
};

struct PoseGradient {
    std::size_t pose = 0;
    Twist gradient{};
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
    /// [kGroupsPerPose, maximum number of poses in a frame, 6] one row for each of the
    /// `kGroupsPerPose` workgroups that share the work for a pose
    const Array<float>& gradient_sums() const { return rows_; }
    std::vector<PoseGradient> sum_gradients(std::span<const float> sums,
                                            const TrainingFrameData& frame) const;

private:
    /// workgroups per pose, so that the GPU has enough parallel work
    static constexpr std::uint32_t kGroupsPerPose = 16;

    std::uint32_t most_knots_;
    Array<DeviceRay> moved_;         ///< [maximum rays of a frame] rays of the frame of the last move_rays()
    Array<shared::PoseKnot> knots_;  ///< [most_knots_] poses of the same frame
    Array<float, shared::KnotGradientRows> rows_;
    Kernel<shared::MoveRaysParams> move_;
    Kernel<shared::KnotGradientsParams> gradients_;
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
    PoseRefiner(Device& device, const Log& sequence, const Scene& layout, const TrainConfig& config,
                const TrainingFrames& frames);
    ~PoseRefiner();

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
    /// Waits for the pending gradients, so that a checkpoint can store them. Does not
    /// update the poses.
    void wait_for_pending(Stream& stream);
    RefinedPoses refined_poses() const;

    template <class Visitor>
    void visit_state(Visitor&& visit) {
        if (!is_enabled()) return;
        if (sensor_) sensor_->visit_state("poses/sensor", visit);
        for (RefinedActor& actor : actors_)
            actor.correction.visit_state("poses/actor " + poses_.boxes[actor.box].id, visit);
        // iterations whose gradients were not yet applied
        visit("poses/coming/step", pending_iterations_.step);
        visit("poses/coming/frame", pending_iterations_.frame);
        visit("poses/coming/actor_time_s", pending_iterations_.actor_time_s);
        visit("poses/coming/gradient", pending_iterations_.gradient);
    }
    void update_corrected();

private:
    struct RefinedActor {
        std::size_t instance;  ///< index of the instance in the scene
        std::size_t box;       ///< index of the box in the sequence
        TrackCorrection correction;
    };

    /// Iterations whose pose gradients were not applied yet, oldest first.
    struct PendingPoseIterations {
        std::vector<std::uint64_t> step;
        /// index of the iteration's frame in the list of training frames
        std::vector<std::uint64_t> frame;
        /// [iterations, actors, 2] start and end of the time in which each actor was
        /// visible
        std::vector<double> actor_time_s;
        /// [iterations, floats_of_rays_ + floats_of_instances_] gradients; written by
        /// wait_for_gradient()
        std::vector<float> gradient;
    };

    const TrainConfig& config_;
    const bool is_active_;
    const TrainingFrames& frames_;
    Scene layout_;
    Log poses_;  ///< the log without its scans, with the current corrections
    std::optional<TrackCorrection> sensor_;
    std::unique_ptr<PoseCorrectedRays> rays_;
    std::vector<RefinedActor> actors_;
    PendingPoseIterations pending_iterations_;
    std::size_t floats_of_rays_ = 0, floats_of_instances_ = 0;
    /// [kReadbackLag] host buffers for gradients; iteration i uses buffer i modulo
    /// kReadbackLag. Empty if the poses of sensor or actors are not corrected.
    std::vector<ReadbackBuffer> of_rays_, of_instances_;

    /// Returns the gradients of a pending iteration. Waits until they are on the host.
    std::span<float> wait_for_gradient(Stream& stream, std::size_t pending_index);
    void apply_oldest(Stream& stream);
    void apply_actor_gradients(std::span<const float> instance_gradients, int step);
};

}  // namespace relidar
