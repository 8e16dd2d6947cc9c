// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include <relidar/diff/densify.hpp>
#include <relidar/diff/differentiable_renderer.hpp>
#include <relidar/diff/optimizer.hpp>
#include <relidar/run/checkpoint.hpp>
#include <relidar/train/train.hpp>

#include "base/random.hpp"
#include "train/drops/drop_excess.hpp"
#include "train/frames/batch.hpp"
#include "train/frames/sensor_drop.hpp"
#include "train/frames/training_frames.hpp"
#include "train/poses/pose_refiner.hpp"
#include "train/reports/iteration_reports.hpp"

namespace relidar {

/// Draws training frames in random order. Each frame is drawn once per epoch.
class FrameSampler {
public:
    FrameSampler(std::size_t n, std::uint64_t seed);
    std::size_t next_frame();
    /// Nothing at the end of an epoch: the next order is still unknown.
    std::optional<std::size_t> peek_frame() const;
    Random& generator() { return random_; }

    template <class Visitor>
    void visit_state(Visitor&& visit) {
        visit("sampler/order", order_);
        visit("sampler/position", position_);
        visit("sampler/random", random_.state());
    }

private:
    std::vector<std::uint64_t> order_;
    std::uint64_t position_ = 0;
    Random random_;
};

class TrainLoop {
public:
    /// @param n_fixed_surfels  the first n_fixed_surfels surfels of the scene are not
    /// trained
    /// @param extent_m  of the background; if empty, computed from the initial scene
    TrainLoop(Device& device, const Log& log, const Split& split, const Scene& initial, const Config& config,
              std::uint32_t n_fixed_surfels = 0, std::optional<double> extent_m = std::nullopt);
    ~TrainLoop();
    TrainLoop(const TrainLoop&) = delete;
    TrainLoop& operator=(const TrainLoop&) = delete;

    /// Adds losses that the caller owns to those of the settings.
    void add_losses(const std::vector<Loss*>& losses) {
        active_losses_.insert(active_losses_.end(), losses.begin(), losses.end());
    }
    /// Submits one iteration. Waits only for an earlier submission, for densification, or
    /// to increase the memory for hits.
    /// @param step  counts from 1
    /// @throws DataError naming iteration, frame and term if a loss was not finite in the
    /// last 64 + kReadbackLag iterations
    void run_iteration(int step, bool is_last_of_log_interval = false);
    /// New since the last call: kReadbackLag iterations later, or after finish_steps().
    std::vector<TrainLogLine> take_log_lines() { return reports_.take_log_lines(); }
    /// Waits for all submitted iterations and reads their reports.
    /// @throws DataError if a loss of these iterations was not finite
    void finish_steps();
    /// Waits for all iterations and applies the pose updates that are still pending.
    void finish();
    /// Waits for all iterations and saves the complete training state.
    /// @throws DataError if a loss of these iterations was not finite
    void save_to(Checkpoint& checkpoint);
    /// Restores the state from a checkpoint. The loop must have been created with the
    /// scene and the log of the checkpoint.
    /// @throws DataError if an array is missing or has another shape
    void restore_from(const Checkpoint& checkpoint);
    /// Returns the rates at which the sensor drops rays that the scene returns. Waits for
    /// the device.
    RayDropTable sensor_drop_rates(Device& device, const Log& log);
    std::optional<RefinedPoses> refined_poses() const {
        return refiner_.is_enabled() ? std::optional(refiner_.refined_poses()) : std::nullopt;
    }
    Scene download_scene() { return renderer_.download_scene(); }
    const KernelTimes& training_times() { return renderer_.stream().times(); }
    std::uint32_t surfel_count() const { return renderer_.scene().size(); }
    std::uint32_t last_batch_rays() const { return renderer_.last_batch().rays.n_rays; }
    /// Maximum number of hits of a ray that are stored for the backward pass; can grow.
    std::uint32_t max_stored_hits() const { return renderer_.stored_hits_per_ray(); }
    const TrainingFrames& training_frames() const { return frames_; }

private:
    const Config& config_;
    const std::uint32_t n_fixed_;
    TrainingFrames frames_;
    BatchSampler batches_;
    PoseRefiner refiner_;
    DifferentiableRenderer differentiable_;
    Renderer& renderer_;                         ///< the renderer of differentiable_
    Stream& stream_;                             ///< the stream of the renderer
    std::vector<std::unique_ptr<Loss>> losses_;  ///< the losses of the settings
    std::vector<Loss*> active_losses_;           ///< losses_, then the losses of the caller
    Adam adam_;
    Densifier densifier_;
    DensifyReport densified_;
    IterationReports reports_;
    double extent_m_;
    FrameSampler sampler_;
    std::uint64_t submitted_ = 0;  ///< submission ticket of the last iteration
    int last_step_ = 0;
    bool hit_memory_exhausted_ = false;  ///< true if device memory was too small to store more hits per ray

    /// A state variable that is missing here is lost when training is resumed.
    template <class Visitor>
    void visit_state(Visitor&& visit) {
        visit("parameters", renderer_.scene().surfel_parameters());
        visit("moment1", adam_.first_moments());
        visit("moment2", adam_.second_moments());
        if (adam_.max_log_scales().size() > 0) visit("max_log_scale", adam_.max_log_scales());
        visit("extent_m", extent_m_);
        reports_.visit_state(visit);
        sampler_.visit_state(visit);
        refiner_.visit_state(visit);
        if (!densifier_.is_enabled()) return;
        visit("densify/extents_m", densifier_.model_extents_m());
        SurfelStatistics& s = densifier_.statistics();
        visit("densify/gradient_sum", ArrayPrefix<float>{s.gradient_sum, renderer_.scene().size()});
        visit("densify/n_seen", ArrayPrefix<std::uint32_t>{s.n_observing_batches, renderer_.scene().size()});
        visit("densify/frames",
              ArrayPrefix<std::uint32_t>{s.frames, std::size_t(renderer_.scene().size()) * s.n_words});
        for (const auto& [name, count] : kDensifyCounts)
            visit(std::string("densify/report/") + name, densified_.*count);
    }

    /// Uploads a frame if it is not on the device, moves its rays to the corrected poses,
    /// and records the poses of its instances.
    const TrainingFrameData& upload_frame(std::size_t frame_index, bool surfels_changed);
    void record_losses(const SampledBatch& batch);
    void record_adam_step(int step);
    void densify_surfels(int step);
    void check_reports(int last_step);
    void start_readback(const std::optional<TrainLogLine>& line = std::nullopt);
    /// Increases the capacity of the hit buffer if more than half of it was used.
    /// @throws DeviceError if a deterministic step exceeded the capacity
    void grow_hit_capacity(const IterationReport& report);
    /// Stores more hits per ray if many rays had more, because these are traced twice.
    void resize_stored_hits(const IterationReport& report);
    void add_checked_rays(std::vector<CheckedRay>& rays, const Log& log, const TrainingFrameData& frame,
                          const SampledBatch& batch);
};

}  // namespace relidar
