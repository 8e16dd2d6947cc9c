// SPDX-License-Identifier: Apache-2.0
#include "train/poses/pose_refiner.hpp"

#include <algorithm>
#include <cstring>

#include <relidar/diff/backward.hpp>
#include <relidar/diff/optimizer.hpp>
#include <relidar/train/train.hpp>

#include "train/frames/training_frames.hpp"
#include "train/iteration_reports.hpp"
#include "train/poses/moved_rays.hpp"

namespace relidar {
namespace {

// Learning rate at the end of training, relative to the start.
constexpr double kFinalShare = 0.1;
/// Learning rates are multiples of train.pose_rate_m, that of the sensor position in
/// metres. The rotation rate in radians is a tenth, because most returns are about 10 m
/// away. The rates of boxes are ten times as large, like their initial errors.
constexpr double kMetresPerRadian = 10.0, kBoxFactor = 10.0;
/// Weights of the squared corrections in the loss, so small that they affect only poses
/// that no ray constrains.
constexpr double kPriorPerM2 = 0.01, kPriorPerRad2 = 0.1;

Log copy_without_scans(const Log& sequence) {
    Log result = strip_frames(sequence);
    for (const Frame& frame : sequence.frames) result.frames.push_back(strip_scan(frame));
    return result;
}

/// Pending iterations need separate buffers.
void allocate_readbacks(std::vector<ReadbackBuffer>& buffers, Device& device, std::size_t n,
                        const char* text) {
    while (int(buffers.size()) < kReadbackLag) buffers.emplace_back(device, n * sizeof(float), text);
}

template <class T>
void remove_first(std::vector<T>& values, std::size_t count) {
    values.erase(values.begin(), values.begin() + std::ptrdiff_t(count));
}

PoseStepRates pose_rates(const TrainConfig& config, double initial_rate_m, int step) {
    const double decay = interpolate_exp(1.0, kFinalShare, step, config.iterations);
    return {initial_rate_m * decay, initial_rate_m / kMetresPerRadian * decay, kPriorPerM2, kPriorPerRad2};
}

}  // namespace

PoseRefiner::PoseRefiner(Device& device, const Log& sequence, const Scene& layout, const TrainConfig& config,
                         const TrainingFrames& frames)
    : config_(config),
      is_active_(config.refine_poses != "none"),
      frames_(frames),
      layout_(strip_surfels(layout)),
      poses_(copy_without_scans(sequence)) {
    if (config.refines("sensor")) {
        sensor_.emplace(sequence.world_from_vehicle);
        rays_ = std::make_unique<PoseCorrectedRays>(device, frames.all());
        floats_of_rays_ = rays_->gradient_sums().size();
        allocate_readbacks(of_rays_, device, floats_of_rays_, "pose gradients of rays");
    }
    if (!config.refines("actors")) return;
    for (std::size_t i = 0; i < layout_.instances.size(); ++i) {
        if (const BoxTrack* box = find_box(sequence, layout_.instances[i].track))
            actors_.push_back(
                {i, std::size_t(box - sequence.boxes.data()), TrackCorrection(box->world_from_box)});
    }
    if (actors_.empty()) return;
    // 6 values per instance: rotation and translation
    floats_of_instances_ = 6 * layout_.instances.size();
    allocate_readbacks(of_instances_, device, floats_of_instances_, "pose gradients of instances");
}

PoseRefiner::~PoseRefiner() = default;

RefinedPoses PoseRefiner::refined_poses() const { return {poses_.world_from_vehicle, poses_.boxes}; }

GradientSelection PoseRefiner::required_gradients() const {
    return {.rays = sensor_.has_value(), .poses = !actors_.empty()};
}

/// Moves the rays of a frame, its actors and its sensor position to the corrected poses.
void PoseRefiner::move_frame(Stream& stream, TrainingFrameData& frame) {
    if (!is_enabled()) return;
    if (rays_) rays_->move_rays(stream, *sensor_, frame);
    const Frame& sweep = poses_.frames[std::size_t(frame.position)];
    frame.placed = pose_instances(layout_, poses_, timing_of(sweep));
    frame.sensor_position_m = glm::vec3(
        poses_.world_from_vehicle.mounted_pose_at(sweep.time_s, poses_.lidar_of(sweep).vehicle_from_sensor)
            .translation);
}

void PoseRefiner::record_gradients(Stream& stream, std::size_t frame_index, const TrainingFrameData& frame,
                                   const SampledBatch& batch, const DeviceGradients& gradients, int step) {
    if (!is_enabled()) return;
    const std::size_t slot = std::size_t(step) % kReadbackLag;
    if (rays_) {
        rays_->record_sums(stream, frame, batch, gradients.rays);
        of_rays_[slot].record_copy(stream, rays_->gradient_sums().buffer(), floats_of_rays_ * sizeof(float));
    }
    if (!actors_.empty())
        of_instances_[slot].record_copy(stream, gradients.poses.buffer(),
                                        floats_of_instances_ * sizeof(float));
    pending_iterations_.step.push_back(std::uint64_t(step));
    pending_iterations_.frame.push_back(frame_index);
    for (const RefinedActor& actor : actors_) {
        const InstancePose& placed = frame.placed[actor.instance];
        for (const double side : {-1.0, 1.0})
            pending_iterations_.actor_time_s.push_back(placed.time_s + side * placed.motion.half_span_s);
    }
    pending_iterations_.gradient.resize(pending_iterations_.gradient.size() + floats_of_rays_ +
                                        floats_of_instances_);
}

std::span<float> PoseRefiner::wait_for_gradient(Stream& stream, std::size_t pending_index) {
    const std::size_t n = floats_of_rays_ + floats_of_instances_,
                      slot = pending_iterations_.step[pending_index] % kReadbackLag;
    const std::span<float> gradient(pending_iterations_.gradient.data() + pending_index * n, n);
    // If no copy is pending, an earlier call or a checkpoint has filled the row.
    if (rays_ && of_rays_[slot].is_pending())
        std::memcpy(gradient.data(), of_rays_[slot].wait_for_bytes(stream), floats_of_rays_ * sizeof(float));
    if (!actors_.empty() && of_instances_[slot].is_pending())
        std::memcpy(gradient.data() + floats_of_rays_, of_instances_[slot].wait_for_bytes(stream),
                    floats_of_instances_ * sizeof(float));
    return gradient;
}

void PoseRefiner::wait_for_pending(Stream& stream) {
    for (std::size_t i = 0; i < pending_iterations_.step.size(); ++i) wait_for_gradient(stream, i);
}

/// Updates the poses with the gradients of the oldest pending iteration, and removes it
/// from the list.
void PoseRefiner::apply_oldest(Stream& stream) {
    const std::span<const float> gradient = wait_for_gradient(stream, 0);
    const int step = static_cast<int>(pending_iterations_.step.front());
    if (rays_) {
        for (const PoseGradient& g : rays_->sum_gradients(gradient.first(floats_of_rays_),
                                                          frames_.all()[pending_iterations_.frame.front()]))
            sensor_->add_gradient(g.pose, 1.0, g.gradient);
        sensor_->run_adam_step(pose_rates(config_, config_.pose_rate_m, step));
        sensor_->remove_mean_motion();
    }
    for (std::size_t k = 0; k < actors_.size(); ++k) {
        Twist twist;
        std::copy_n(gradient.begin() + std::ptrdiff_t(floats_of_rays_ + 6 * actors_[k].instance), 6,
                    twist.begin());
        // The pose of the actor is the mean of its poses at the first and the last time
        // at which a sweep observes it. Each of these two poses gets half of the
        // gradient.
        for (double& g : twist) g *= 0.5;
        // The actor may be absent from the frame. Its gradient is then zero, and
        // add_gradient() ignores zero gradients.
        for (std::size_t end = 0; end < 2; ++end)
            actors_[k].correction.add_gradient(pending_iterations_.actor_time_s[2 * k + end], twist);
        actors_[k].correction.run_adam_step(pose_rates(config_, kBoxFactor * config_.pose_rate_m, step));
    }
    remove_first(pending_iterations_.step, 1);
    remove_first(pending_iterations_.frame, 1);
    remove_first(pending_iterations_.actor_time_s, 2 * actors_.size());
    remove_first(pending_iterations_.gradient, floats_of_rays_ + floats_of_instances_);
}

void PoseRefiner::apply_until(Stream& stream, int last_step) {
    if (pending_iterations_.step.empty() || int(pending_iterations_.step.front()) > last_step) return;
    while (!pending_iterations_.step.empty() && int(pending_iterations_.step.front()) <= last_step)
        apply_oldest(stream);
    update_corrected();
}

void PoseRefiner::update_corrected() {
    if (sensor_) poses_.world_from_vehicle = sensor_->corrected_track();
    for (const RefinedActor& actor : actors_)
        poses_.boxes[actor.box].world_from_box = actor.correction.corrected_track();
}

}  // namespace relidar
