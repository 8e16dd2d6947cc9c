// SPDX-License-Identifier: Apache-2.0
// One training iteration and everything it touches on the device.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include <relidar/diff/densify.hpp>
#include <relidar/diff/differentiable_renderer.hpp>
#include <relidar/diff/optimizer.hpp>
#include <relidar/run/checkpoint.hpp>
#include <relidar/train/train.hpp>

#include "base/random.hpp"
#include "train/drops/sensor_drop.hpp"
#include "train/frames/batch.hpp"
#include "train/frames/training_frames.hpp"
#include "train/iteration_reports.hpp"
#include "train/poses/pose_refiner.hpp"

namespace relidar {

/// Frames in random order, each once an epoch.
class FrameSampler {
public:
    FrameSampler(std::size_t n, std::uint64_t seed);
    std::size_t next();
    /// What next() will return; nothing where a new epoch begins, whose order is not
    /// drawn yet.
    std::optional<std::size_t> coming() const;
    Random& random() { return random_; }

    template <class Visitor>
    void visit_state(Visitor&& visit) {
        visit("sampler/order", order_);
        visit("sampler/position", position_);
        visit("sampler/random", random_.state());
    }
    /// Whether what was read back can be gone on with.
    bool is_sound(std::size_t n) const;

private:
    std::vector<std::uint64_t> order_;
    std::uint64_t position_ = 0;
    Random random_;
};

class TrainLoop {
public:
    /// @param n_fixed   the first so many surfels stay as they are
    /// @param extent_m  of the background, metres; nothing: the initial scene's
    TrainLoop(Device& device, const Sequence& sequence, const Split& split, const Scene& initial,
              const Config& config, std::uint32_t n_fixed = 0, std::optional<double> extent_m = std::nullopt);
    ~TrainLoop();
    TrainLoop(const TrainLoop&) = delete;
    TrainLoop& operator=(const TrainLoop&) = delete;

    /// Records and submits one iteration. Waits for room in the stream alone, except
    /// where densification is due or a batch has more rays or hits than any before, or
    /// too many rays with more hits than are kept.
    /// @param step counts from 1 @param ends_line  a line of the log ends with it
    /// @throws DataError naming iteration, frame and term where a loss was not finite: at
    /// most 64 + kReadbackLag iterations ago
    void iterate(int step, bool ends_line = false);
    /// Lines of the log that have come back from the device, kReadbackLag iterations late
    /// or after settle().
    std::vector<LogLine> take_lines() { return reports_.take_lines(); }
    /// Waits for what iterations have reported so far, and looks at it. @throws as
    /// iterate
    void settle();
    /// After the last iteration: settles, and takes the steps of poses still on their
    /// way.
    void finish();
    /// Puts everything that training has changed into a checkpoint. Settles. @throws as
    /// iterate
    void save(Checkpoint& checkpoint);
    /// Takes it back. The loop must have been made for the checkpoint's scene and log.
    /// @throws DataError for what does not fit
    void restore(const Checkpoint& checkpoint);
    /// Sensor-level ray-drop, from rays for which the scene as it is now expects a
    /// return. Blocks.
    DropTable estimate_sensor_drop(Device& device, const Sequence& sequence);
    /// Poses as they are now, where they are refined.
    std::optional<RefinedPoses> refined_poses() const {
        return refiner_.is_active() ? std::optional(refiner_.poses()) : std::nullopt;
    }
    /// The scene as it is now. Blocks.
    Scene download() { return renderer_.download(); }
    const KernelTimes& times() { return renderer_.stream().times(); }
    std::uint32_t n_surfels() const { return renderer_.scene().size(); }
    std::uint32_t rays_of_last_batch() const { return renderer_.rendered().rays.n_rays; }
    std::uint32_t kept_hits() const { return renderer_.kept_hits(); }  ///< of a ray, now
    const TrainingFrames& frames() const { return frames_; }

private:
    const Config& config_;
    const std::uint32_t n_fixed_;
    TrainingFrames frames_;
    BatchSampler batches_;
    PoseRefiner refiner_;
    DifferentiableRenderer renderer_;
    Stream& stream_;  ///< the renderer's
    std::vector<std::unique_ptr<Loss>> losses_;
    Adam adam_;
    Densifier densifier_;
    DensifyReport densified_;  ///< since the last log line
    IterationReports reports_;
    double extent_m_;
    FrameSampler sampler_;
    std::uint64_t submitted_ = 0;  ///< ticket of the last iteration
    int last_step_ = 0;
    bool no_room_to_keep_more_ = false;  ///< the device had no memory for more kept hits

    /// All state of the loop: what is not listed here is lost where training stops. A new
    /// kind of state is a line.
    template <class Visitor>
    void visit_state(Visitor&& visit) {
        visit("parameters", renderer_.scene().parameters());
        visit("moment1", adam_.moment1());
        visit("moment2", adam_.moment2());
        if (adam_.max_log_scale().size() > 0) visit("max_log_scale", adam_.max_log_scale());
        visit("extent_m", extent_m_);
        reports_.visit_state(visit);
        sampler_.visit_state(visit);
        refiner_.visit_state(visit);
        if (!densifier_.is_active()) return;
        visit("densify/extents_m", densifier_.extents_m());
        SurfelStatistics& s = densifier_.statistics();
        visit("densify/gradient_sum", FirstOf<float>{s.gradient_sum, renderer_.scene().size()});
        visit("densify/n_seen", FirstOf<std::uint32_t>{s.n_seen, renderer_.scene().size()});
        visit("densify/frames",
              FirstOf<std::uint32_t>{s.frames, std::size_t(renderer_.scene().size()) * s.n_words});
        for (const auto& [name, count] : kDensifyCounts)
            visit(std::string("densify/report/") + name, densified_.*count);
    }

    /// Records a frame's rays, where everything is in it, and the surfels as they look
    /// from there at a step.
    const FrameData& place(std::size_t frame_index, int step);
    /// Brings a frame to the device and the instances to where they are in it. @param
    /// surfels_changed  since the last frame
    const FrameData& bring(std::size_t frame_index, bool surfels_changed);
    /// Records the image of a batch, its losses, and the gradients of those.
    void learn_from(const RayBatch& rays, const TargetBatch& targets, const TermRow& terms);
    /// Looks at the reports of the iterations up to `last`.
    void look_at_reports(int last);
    void close_report(int step, bool ends_line);
    /// Hits of a report's iterations against the room for their records; makes more.
    /// @throws DeviceError where a deterministic step did not fit
    void check_room(const IterationReports::Report& report);
    /// Has the forward pass keep more hits of a ray where too many rays of a report had
    /// more, so that almost none is searched twice.
    void keep_more_hits(const IterationReports::Report& report);
    /// Counts the rays of a batch of a frame for which the scene expects a return.
    void count_drops(DropCounts& counts, const Sequence& sequence, const FrameData& frame,
                     const SampledBatch& batch);
    void change_surfels(const std::function<DensifyReport(double others_bytes)>& change);
};

}  // namespace relidar
