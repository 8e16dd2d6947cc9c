// SPDX-License-Identifier: Apache-2.0
// Corrections of the sensor's poses and of the actors' boxes, found together with the scene (train.refine_poses).
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <relidar/scene.hpp>

#include "train/track_correction.hpp"

namespace relidar {

class MovedRays;
struct FrameData;
struct Gradients;
struct RefinedPoses;
struct SampledBatch;
struct TrainConfig;
struct WantedGradients;

class PoseRefiner {
public:
    /// @param layout of the scene: the tracks of its instances are those corrected
    PoseRefiner(Device& device, const Sequence& sequence, const Scene& layout, const TrainConfig& config, std::vector<FrameData>& frames);
    ~PoseRefiner();

    /// What step() needs of a backward pass.
    WantedGradients wanted(std::uint32_t largest_batch) const;
    /// Rays, actors and view origin of a frame as corrected so far. Records.
    void place(Stream& stream, std::size_t frame_index, FrameData& frame);
    /// One step of the poses that this batch has seen. Waits for the device, which no other training does.
    /// @param step counts from 1; nothing happens up to train.pose_from
    void step(Stream& stream, std::size_t frame_index, const FrameData& frame, const SampledBatch& batch, const Gradients& gradients, int step);
    RefinedPoses poses() const;

    template <class Visitor>
    void visit_state(Visitor&& visit) {
        if (sensor_) sensor_->visit_state("poses/sensor", visit);
        for (Actor& actor : actors_) actor.correction.visit_state("poses/actor " + poses_.boxes[actor.box].id, visit);
    }
    /// After state was read back. @return whether it can be gone on with
    bool take_over();

private:
    struct Actor {
        std::size_t instance;   ///< of the scene
        std::size_t box;        ///< of the sequence
        TrackCorrection correction;
    };

    const TrainConfig& config_;
    Scene layout_;
    Sequence poses_;   ///< the log without its scans, as corrected so far
    std::optional<TrackCorrection> sensor_;
    std::unique_ptr<MovedRays> rays_;
    std::vector<Actor> actors_;

    void update_poses();
};

}  // namespace relidar
