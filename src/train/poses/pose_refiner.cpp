// SPDX-License-Identifier: Apache-2.0
// Corrects the poses of the sensor and of actors. Converts the gradients of rays and
// instances to optimisation steps of the recorded poses.
#include "train/poses/pose_refiner.hpp"

#include <algorithm>
#include <cstring>

#include <relidar/base/error.hpp>
#include <relidar/diff/backward.hpp>
#include <relidar/diff/optimizer.hpp>
#include <relidar/train/train.hpp>

#include "train/frames/training_frames.hpp"
#include "train/poses/moved_rays.hpp"
#include "train/readback_lag.hpp"

namespace relidar {
namespace {

// learning rates at the end of training, relative to the rates at the start
constexpr double kFinalShare = 0.1;
/// Learning rates are multiples of train.pose_rate_m, the learning rate of the sensor
/// position in metres. The rotation rate in radians is a tenth of this rate, because most
/// returns are about 10 m away. The rates of boxes are ten times as high as the rates of
/// the sensor. The initial errors of boxes are about ten times the errors of a registered
/// sensor.
constexpr double kMetresPerRadian = 10.0, kBoxFactor = 10.0;
/// Weights of the squared pose corrections in the loss, per square metre and per square
/// radian. They are small, so that they affect only poses that no ray constrains.
constexpr double kPriorPerM2 = 0.01, kPriorPerRad2 = 0.1;

Sequence copy_without_scans(const Sequence& sequence) {
    Sequence result;
    result.lidars = sequence.lidars;
    result.world_from_vehicle = sequence.world_from_vehicle;
    result.boxes = sequence.boxes;
    result.rolling_shutter = sequence.rolling_shutter;
    for (const Frame& frame : sequence.frames) result.frames.push_back(copy_without_scan(frame));
    return result;
}

/// Allocates host buffers for an array that is copied in each iteration, one per pending
/// iteration.
void allocate_readbacks(std::vector<Readback>& readbacks, Device& device, std::size_t n_floats,
                        const char* description) {
    while (readbacks.size() < kReadbackLag)
        readbacks.emplace_back(device, n_floats * sizeof(float), description);
}

template <class T>
void remove_first_values(std::vector<T>& values, std::size_t count) {
    values.erase(values.begin(), values.begin() + std::ptrdiff_t(count));
}

PoseStep compute_pose_step(const TrainConfig& config, double rate_m, int step) {
    const double decay = interpolate_exponentially(1.0, kFinalShare, step, config.iterations);
    return {rate_m * decay, rate_m / kMetresPerRadian * decay, kPriorPerM2, kPriorPerRad2};
}

}  // namespace

PoseRefiner::PoseRefiner(Device& device, const Sequence& sequence, const Scene& layout,
                         const TrainConfig& config, const TrainingFrames& frames)
    : config_(config),
      is_active_(config.refine_poses != "none"),
      frames_(frames),
      layout_(copy_layout(layout)),
      poses_(copy_without_scans(sequence)) {
    if (config.refines("sensor")) {
        sensor_.emplace(sequence.world_from_vehicle);
        rays_ = std::make_unique<MovedRays>(device, frames.all());
        floats_of_rays_ = rays_->gradient_rows().size();
        allocate_readbacks(of_rays_, device, floats_of_rays_, "pose gradients of rays");
    }
    if (!config.refines("actors")) return;
    for (std::size_t i = 0; i < layout_.instances.size(); ++i) {
        if (const BoxTrack* box = find_box(sequence, layout_.instances[i].track))
            actors_.push_back(
                {i, std::size_t(box - sequence.boxes.data()), TrackCorrection(box->world_from_box)});
    }
    if (actors_.empty()) return;
    floats_of_instances_ = 6 * layout_.instances.size();
    allocate_readbacks(of_instances_, device, floats_of_instances_, "pose gradients of instances");
}

PoseRefiner::~PoseRefiner() = default;

RefinedPoses PoseRefiner::poses() const { return {poses_.world_from_vehicle, poses_.boxes}; }

GradientSelection PoseRefiner::wanted() const {
    return {.rays = sensor_.has_value(), .poses = !actors_.empty()};
}

void PoseRefiner::place(Stream& stream, FrameData& frame) {
    if (!is_active()) return;
    if (rays_) rays_->move(stream, *sensor_, frame);
    const Frame& sweep = poses_.frames[std::size_t(frame.position)];
    frame.placed = place_instances(layout_, poses_, get_sweep_moment(sweep));
    frame.sensor_position_m = glm::vec3(
        poses_.world_from_vehicle.at(sweep.time_s, poses_.get_lidar(sweep).vehicle_from_sensor).translation);
}

void PoseRefiner::record(Stream& stream, std::size_t frame_index, const FrameData& frame,
                         const SampledBatch& batch, const Gradients& gradients, int step) {
    if (!is_active()) return;
    const std::size_t slot = std::size_t(step) % kReadbackLag;
    if (rays_) {
        rays_->sum_gradients(stream, frame, batch, gradients.rays);
        of_rays_[slot].record(stream, rays_->gradient_rows().buffer(), floats_of_rays_ * sizeof(float));
    }
    if (!actors_.empty())
        of_instances_[slot].record(stream, gradients.poses.buffer(), floats_of_instances_ * sizeof(float));
    coming_.step.push_back(std::uint64_t(step));
    coming_.frame.push_back(frame_index);
    for (const Actor& actor : actors_) {
        const InstancePose& placed = frame.placed[actor.instance];
        for (const double side : {-1.0, 1.0})
            coming_.actor_time_s.push_back(placed.time_s + side * placed.motion.half_span_s);
    }
    coming_.gradient.resize(coming_.gradient.size() + floats_of_rays_ + floats_of_instances_);
}

std::span<float> PoseRefiner::fetch(Stream& stream, std::size_t index) {
    const std::size_t n = floats_of_rays_ + floats_of_instances_, slot = coming_.step[index] % kReadbackLag;
    const std::span<float> gradient(coming_.gradient.data() + index * n, n);
    if (rays_ && of_rays_[slot].pending())
        std::memcpy(gradient.data(), of_rays_[slot].wait(stream), floats_of_rays_ * sizeof(float));
    if (!actors_.empty() && of_instances_[slot].pending())
        std::memcpy(gradient.data() + floats_of_rays_, of_instances_[slot].wait(stream),
                    floats_of_instances_ * sizeof(float));
    return gradient;
}

void PoseRefiner::fetch(Stream& stream) {
    for (std::size_t i = 0; i < coming_.step.size(); ++i) fetch(stream, i);
}

void PoseRefiner::apply_oldest_step(Stream& stream) {
    const std::span<const float> gradient = fetch(stream, 0);
    const int step = static_cast<int>(coming_.step.front());
    if (rays_) {
        for (const PoseGradient& g :
             rays_->sum_pose_gradients(gradient.first(floats_of_rays_), frames_.all()[coming_.frame.front()]))
            sensor_->add_gradient(g.pose, 1.0, g.gradient);
        sensor_->step(compute_pose_step(config_, config_.pose_rate_m, step));
        sensor_->remove_common_motion();
    }
    for (std::size_t k = 0; k < actors_.size(); ++k) {
        Twist twist;
        std::copy_n(gradient.begin() + std::ptrdiff_t(floats_of_rays_ + 6 * actors_[k].instance), 6,
                    twist.begin());
        // The gradient belongs to the time interval in which the actor is visible. Gives
        // one half to each end of the interval.
        for (double& g : twist) g *= 0.5;
        // An actor that was absent has a gradient of zero, which add_gradient() ignores.
        for (std::size_t end = 0; end < 2; ++end)
            actors_[k].correction.add_gradient(coming_.actor_time_s[2 * k + end], twist);
        actors_[k].correction.step(compute_pose_step(config_, kBoxFactor * config_.pose_rate_m, step));
    }
    remove_first_values(coming_.step, 1);
    remove_first_values(coming_.frame, 1);
    remove_first_values(coming_.actor_time_s, 2 * actors_.size());
    remove_first_values(coming_.gradient, floats_of_rays_ + floats_of_instances_);
}

void PoseRefiner::apply_steps(Stream& stream, int last) {
    if (coming_.step.empty() || int(coming_.step.front()) > last) return;
    while (!coming_.step.empty() && int(coming_.step.front()) <= last) apply_oldest_step(stream);
    update_poses();
}

void PoseRefiner::update_poses() {
    if (sensor_) poses_.world_from_vehicle = sensor_->make_corrected_track();
    for (const Actor& actor : actors_)
        poses_.boxes[actor.box].world_from_box = actor.correction.make_corrected_track();
}

void PoseRefiner::restore() {
    const std::size_t n = coming_.step.size();
    const bool sound =
        (!sensor_ || sensor_->is_sound()) &&
        std::all_of(actors_.begin(), actors_.end(), [](const Actor& a) { return a.correction.is_sound(); }) &&
        n <= kReadbackLag && coming_.frame.size() == n &&
        coming_.actor_time_s.size() == 2 * n * actors_.size() &&
        coming_.gradient.size() == n * (floats_of_rays_ + floats_of_instances_) &&
        std::all_of(coming_.frame.begin(), coming_.frame.end(),
                    [this](std::uint64_t frame) { return frame < frames_.all().size(); });
    if (!sound) throw DataError("cannot resume: the stored pose corrections do not fit this log");
    update_poses();
}

}  // namespace relidar
