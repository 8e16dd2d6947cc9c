// SPDX-License-Identifier: Apache-2.0
// Corrects the poses of the sensor and of the actors' boxes during training
// (train.refine_poses). The device computes the gradients. The host updates the poses in
// double precision, which is fast because there are few poses. Each update is applied a
// fixed number of iterations later, so that the host does not wait (readback_lag.hpp). A
// checkpoint includes the pending gradients. Therefore a resumed training gives the same
// result.
#pragma once

#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <relidar/gpu/stream.hpp>
#include <relidar/scene/scene.hpp>

#include "train/poses/track_correction.hpp"

namespace relidar {

class MovedRays;
class TrainingFrames;
struct FrameData;
struct Gradients;
struct RefinedPoses;
struct SampledBatch;
struct TrainConfig;
struct GradientSelection;

class PoseRefiner {
public:
    /// Creates the pose corrections.
    /// @param layout  layout of the scene; the tracks of its instances are corrected
    /// @param config  train.refine_poses selects which poses are corrected; with "none",
    /// all functions of this class do nothing
    PoseRefiner(Device& device, const Sequence& sequence, const Scene& layout, const TrainConfig& config,
                const TrainingFrames& frames);
    ~PoseRefiner();

    bool is_active() const { return is_active_; }
    /// Returns the gradients that the backward pass must compute for record().
    GradientSelection wanted() const;
    /// Moves a frame to the corrected poses: its rays, actors and sensor position. The
    /// frame must be on the device.
    void place(Stream& stream, FrameData& frame);
    /// Records GPU commands that compute the pose gradients of a batch and copy them to
    /// the host, where apply_steps() uses them later.
    /// @param step  counts from 1
    void record(Stream& stream, std::size_t frame_index, const FrameData& frame, const SampledBatch& batch,
                const Gradients& gradients, int step);
    /// Updates the poses with the gradients of all pending iterations up to `last`, in
    /// order. Waits for these gradients if necessary.
    void apply_steps(Stream& stream, int last);
    /// Waits for the pending gradients without updating the poses, so that a checkpoint
    /// can store the gradients.
    void fetch(Stream& stream);
    RefinedPoses poses() const;

    template <class Visitor>
    void visit_state(Visitor&& visit) {
        if (!is_active()) return;
        if (sensor_) sensor_->visit_state("poses/sensor", visit);
        for (Actor& actor : actors_)
            actor.correction.visit_state("poses/actor " + poses_.boxes[actor.box].id, visit);
        visit("poses/coming/step", coming_.step);
        visit("poses/coming/frame", coming_.frame);
        visit("poses/coming/actor_time_s", coming_.actor_time_s);
        visit("poses/coming/gradient", coming_.gradient);
    }
    /// Recomputes the corrected poses after the state was read from a checkpoint.
    /// @throws DataError if the state does not fit the log
    void restore();

private:
    struct Actor {
        std::size_t instance;  ///< index of the instance in the scene
        std::size_t box;       ///< index of the box in the sequence
        TrackCorrection correction;
    };

    /// Iterations whose pose gradients are still to be applied, oldest first.
    struct Coming {
        std::vector<std::uint64_t> step;
        /// index of the iteration's frame in the list of training frames
        std::vector<std::uint64_t> frame;
        /// [iterations, actors, 2] start and end of the time in which each actor was
        /// visible
        std::vector<double> actor_time_s;
        /// [iterations, floats_of_rays_ + floats_of_instances_] gradients; filled by
        /// fetch()
        std::vector<float> gradient;
    };

    const TrainConfig& config_;
    const bool is_active_;
    const TrainingFrames& frames_;
    Scene layout_;
    Sequence poses_;  ///< the log without its scans, with the current corrections
    std::optional<TrackCorrection> sensor_;
    std::unique_ptr<MovedRays> rays_;
    std::vector<Actor> actors_;
    Coming coming_;
    std::size_t floats_of_rays_ = 0, floats_of_instances_ = 0;
    /// [kReadbackLag] host buffers for gradients; iteration i uses buffer i modulo
    /// kReadbackLag. Empty if the poses of sensor or actors are not corrected.
    std::vector<Readback> of_rays_, of_instances_;

    /// Returns the gradients of the i-th pending iteration. Waits until the gradients are
    /// on the host.
    std::span<float> fetch(Stream& stream, std::size_t index);
    void apply_oldest_step(Stream& stream);
    void update_poses();
};

}  // namespace relidar
