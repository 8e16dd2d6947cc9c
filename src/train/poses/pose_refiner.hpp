// SPDX-License-Identifier: Apache-2.0
// Corrects the poses of the sensor and of the actors' boxes during training
// (train.refine_poses). The host updates the few poses in double precision, a fixed
// number of iterations later, so that it does not wait (kReadbackLag). A checkpoint
// includes the pending gradients.
#pragma once

#include <memory>
#include <optional>
#include <span>
#include <vector>

#include <relidar/gpu/stream.hpp>
#include <relidar/scene/scene.hpp>

#include "train/poses/track_correction.hpp"

namespace relidar {

class PoseCorrectedRays;
class TrainingFrames;
struct TrainingFrameData;
struct DeviceGradients;
struct RefinedPoses;
struct SampledBatch;
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
};

}  // namespace relidar
