// SPDX-License-Identifier: Apache-2.0
// Corrections of the sensor's poses and of the actors' boxes, found together with the
// scene (train.refine_poses). Gradients come from the device, steps are taken on the
// host, where a few poses are no work and double precision is at hand: a fixed number of
// iterations later, so that nothing waits (readback_lag.hpp). A checkpoint holds what is
// on its way, so that resuming changes nothing.
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
struct WantedGradients;

class PoseRefiner {
public:
    /// @param layout of the scene: the tracks of its instances are those corrected
    /// @param config  train.refine_poses says what is corrected; with "none" this does
    /// nothing
    PoseRefiner(Device& device, const Sequence& sequence, const Scene& layout, const TrainConfig& config,
                const TrainingFrames& frames);
    ~PoseRefiner();

    bool is_active() const { return is_active_; }
    /// What record() needs of a backward pass.
    WantedGradients wanted() const;
    /// Rays, actors and view origin of a frame that is on the device, as corrected so
    /// far. Records.
    void place(Stream& stream, FrameData& frame);
    /// Records the gradients of the poses that this batch has seen, on their way to
    /// take_steps().
    /// @param step counts from 1
    void record(Stream& stream, std::size_t frame_index, const FrameData& frame, const SampledBatch& batch,
                const Gradients& gradients, int step);
    /// Takes the steps of all iterations up to `last` that were not taken yet, in order.
    /// Waits where gradients are not there yet.
    void take_steps(Stream& stream, int last);
    /// Waits for the gradients on their way: they are then part of the state. No step is
    /// taken.
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
    /// After state was read back. @return whether it can be gone on with
    bool take_over();

private:
    struct Actor {
        std::size_t instance;  ///< of the scene
        std::size_t box;       ///< of the sequence
        TrackCorrection correction;
    };

    /// Iterations whose steps are to be taken, oldest first.
    struct Coming {
        std::vector<std::uint64_t> step;
        std::vector<std::uint64_t> frame;  ///< index of the constructor's frames
        /// [iterations, actors, 2] first and last time at which each was seen
        std::vector<double> actor_time_s;
        std::vector<float> gradient;  ///< [iterations, floats_of_rays_ + floats_of_instances_] once fetched
    };

    const TrainConfig& config_;
    const bool is_active_;
    const TrainingFrames& frames_;
    Scene layout_;
    Sequence poses_;  ///< the log without its scans, as corrected so far
    std::optional<TrackCorrection> sensor_;
    std::unique_ptr<MovedRays> rays_;
    std::vector<Actor> actors_;
    Coming coming_;
    std::size_t floats_of_rays_ = 0, floats_of_instances_ = 0;
    std::vector<Readback> of_rays_, of_instances_;  ///< [kReadbackLag] by iteration; none where not refined

    /// What iteration i of those coming has left, when it is there.
    std::span<float> fetch(Stream& stream, std::size_t i);
    void take_oldest_step(Stream& stream);
    void update_poses();
};

}  // namespace relidar
