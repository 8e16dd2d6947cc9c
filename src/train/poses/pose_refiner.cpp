// SPDX-License-Identifier: Apache-2.0
#include "train/poses/pose_refiner.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <relidar/diff/backward.hpp>
#include <relidar/diff/optimizer.hpp>
#include <relidar/train/train.hpp>

#include "base/assert.hpp"
#include "gpu/stream.hpp"
#include "train/frames/training_frames.hpp"
#include "train/reports/iteration_reports.hpp"

namespace relidar {
namespace {

std::uint32_t max_frame_poses(const std::vector<TrainingFrameData>& frames) {
    std::uint32_t most = 0;
    for (const TrainingFrameData& frame : frames) most = std::max(most, frame.n_knots);
    return most;
}

constexpr double kBeta1 = 0.9, kBeta2 = 0.99, kEpsilon = 1e-15;

glm::dvec3 three_components(const Twist& twist, std::size_t first_index) {
    return {twist[first_index], twist[first_index + 1], twist[first_index + 2]};
}

constexpr double kFinalShare = 0.1;  // learning rate at the end of training, relative to the start
/// Learning rates are multiples of train.pose_rate_m, that of the sensor position in
/// metres. The rotation rate in radians is a tenth, because most returns are about 10 m
/// away. The rates of boxes are ten times as large, like their initial errors.
constexpr double kMetresPerRadian = 10.0, kBoxFactor = 10.0;
/// Small weights of the squared corrections in the loss. Rays outweigh them.
constexpr double kPriorPerM2 = 0.01, kPriorPerRad2 = 0.1;

Log copy_without_scans(const Log& log) {
    Log result = strip_frames(log);
    for (const Frame& frame : log.frames) result.frames.push_back(strip_scan(frame));
    return result;
}

PoseStepRates pose_rates(const TrainConfig& config, double initial_rate_m, int step) {
    const double decay = interpolate_exp(1.0, kFinalShare, step, config.iterations);
    return {initial_rate_m * decay, initial_rate_m / kMetresPerRadian * decay, kPriorPerM2, kPriorPerRad2};
}

}  // namespace

PoseCorrectedRays::PoseCorrectedRays(Device& device, const std::vector<TrainingFrameData>& frames)
    : max_knots_(max_frame_poses(frames)),
      moved_(device, max_frame_rays(frames), "moved rays"),
      knots_(device, max_knots_, "sensor poses"),
      partial_sums_(device, std::size_t(kGroupsPerPose) * 6 * max_knots_, "pose gradients"),
      move_(device, "train/move_rays"),
      gradients_(device, "train/knot_gradients",
                 {{SpecialisationConstantId::WORKGROUP_SIZE, RELIDAR_KNOT_WORKGROUP}}) {}

void PoseCorrectedRays::move_rays(Stream& stream, const TrackCorrection& correction,
                                  TrainingFrameData& frame) {
    // A knot is a pose of the vehicle and its correction (translation, rotation). The
    // kernel interpolates between the knots before and after each ray.
    std::vector<shared::PoseKnot> knots;
    for (std::size_t k = frame.first_knot; k < frame.first_knot + frame.n_knots; ++k) {
        const Twist twist = correction.correction_at(k);
        knots.push_back({glm::vec3(correction.uncorrected_track().pose[k].translation),
                         glm::vec3(three_components(twist, 0)), glm::vec3(three_components(twist, 3))});
    }
    stream.impl().record_write(knots_.buffer(), knots.data(), knots.size() * sizeof(knots[0]));
    run(stream, move_, frame.n_rays,
        {.rays = frame.arrays->rays.address(),
         .interpolations = frame.arrays->track_positions.address(),
         .knots = knots_.address(),
         .moved = moved_.address(),
         .n_rays = frame.n_rays});
    frame.moved_rays = &moved_;
}

/// Runs a kernel that sums the gradients of the rays for each pose ("knot") of the frame.
/// Each of kGroupsPerPose workgroups per knot writes one partial sum, a row of 6 values.
/// @param ray_gradients  [rays, 6] gradients with respect to origin and direction
void PoseCorrectedRays::record_sums(Stream& stream, const TrainingFrameData& frame, const SampledBatch& batch,
                                    const Array<float, shared::DeviceRayGradients>& ray_gradients) {
    RELIDAR_ASSERT_LE(std::size_t(6) * batch.rays.n_rays, ray_gradients.size());
    run(stream, gradients_, std::size_t(RELIDAR_KNOT_WORKGROUP) * kGroupsPerPose * max_knots_,
        {.moved = batch.rays.rays->address(),
         .interpolations = frame.arrays->track_positions.address(),
         .knots = knots_.address(),
         .d_rays = ray_gradients.address(),
         .rows = partial_sums_.address(),
         .n_rays = batch.rays.n_rays,
         // Rays of the batch in the frame: columns, or every n-th if `columns` is 0.
         .first_ray = batch.rays.first,
         .ray_stride = batch.rays.stride,
         .columns = batch.window.columns,
         .first_column = batch.window.first,
         .column_stride = batch.window.stride,
         .n_columns = batch.window.n_columns,
         .n_knots = max_knots_,
         .n_rows = kGroupsPerPose});
}

std::vector<Twist> PoseCorrectedRays::sum_gradients(std::span<const float> partial_sums,
                                                    std::uint32_t n_knots) const {
    std::vector<Twist> gradients(n_knots, Twist{});
    for (std::size_t knot = 0; knot < n_knots; ++knot)
        for (std::size_t group = 0; group < kGroupsPerPose; ++group) {
            const auto sums = partial_sums.subspan(6 * (group * max_knots_ + knot), 6);
            for (std::size_t i = 0; i < 6; ++i) gradients[knot][i] += sums[i];
        }
    return gradients;
}

TrackCorrection::TrackCorrection(PoseTrack track, std::vector<std::vector<UnobservedMotion>> unobserved)
    : track_(std::move(track)),
      unobserved_(std::move(unobserved)),
      values_(6 * track_.pose.size(), 0.0),
      moment1_(values_),
      moment2_(values_),
      n_steps_(track_.pose.size(), 0),
      gradient_(values_),
      visited_(track_.pose.size(), false) {}

Twist TrackCorrection::stored_correction(std::size_t pose_index) const {
    Twist twist;
    std::copy_n(values_.begin() + std::ptrdiff_t(6 * pose_index), 6, twist.begin());
    return twist;
}

Twist TrackCorrection::correction_at(std::size_t pose_index) const {
    // The nearest corrected poses before and after, or uncorrected ends of the track.
    const auto is_corrected = [this](std::size_t index) { return n_steps_[index] > 0; };
    std::size_t before = pose_index, after = pose_index;
    while (before > 0 && !is_corrected(before)) --before;
    while (after + 1 < n_steps_.size() && !is_corrected(after)) ++after;
    if (!is_corrected(before) && !is_corrected(after)) return {};
    if (before == after || !is_corrected(after)) return stored_correction(before);
    if (!is_corrected(before)) return stored_correction(after);
    const double s =
        (track_.time_s[pose_index] - track_.time_s[before]) / (track_.time_s[after] - track_.time_s[before]);
    Twist twist;
    for (std::size_t i = 0; i < 6; ++i)
        twist[i] = (1.0 - s) * stored_correction(before)[i] + s * stored_correction(after)[i];
    return twist;
}

PoseTrack TrackCorrection::corrected_track() const {
    PoseTrack result = track_;
    for (std::size_t k = 0; k < result.pose.size(); ++k)
        result.pose[k] = apply_twist(track_.pose[k], correction_at(k));
    return result;
}

void TrackCorrection::add_gradient(double t_s, const Twist& gradient) {
    // A pose is interpolated between two poses, so each gets its share of the gradient.
    const auto [left, s] = track_.find_segment(t_s);
    add_gradient(left, 1.0 - s, gradient);
    if (s != 0.0) add_gradient(left + 1, s, gradient);
}

void TrackCorrection::add_gradient(std::size_t pose_index, double weight, const Twist& gradient) {
    if (std::all_of(gradient.begin(), gradient.end(), [weight](double g) { return weight * g == 0.0; }))
        return;
    for (std::size_t i = 0; i < 6; ++i) gradient_[6 * pose_index + i] += weight * gradient[i];
    visited_[pose_index] = true;
}

void TrackCorrection::run_adam_step(const PoseStepRates& step_rates) {
    for (std::size_t pose = 0; pose < visited_.size(); ++pose) {
        if (!visited_[pose]) continue;
        visited_[pose] = false;
        const double step = double(++n_steps_[pose]);
        const double bias1 = 1.0 - std::pow(kBeta1, step), bias2 = 1.0 - std::pow(kBeta2, step);
        Twist move;
        for (std::size_t k = 0; k < 6; ++k) {
            const std::size_t i = 6 * pose + k;
            const bool is_translation = k < 3;
            const double rate = is_translation ? step_rates.rate_m : step_rates.rate_rad;
            const double prior = is_translation ? step_rates.prior_per_m2 : step_rates.prior_per_rad2;
            // The prior is prior * value^2.
            const double gradient = gradient_[i] + 2.0 * prior * values_[i];
            moment1_[i] += (1.0 - kBeta1) * (gradient - moment1_[i]);
            moment2_[i] += (1.0 - kBeta2) * (gradient * gradient - moment2_[i]);
            move[k] = -rate * (moment1_[i] / bias1) / (std::sqrt(moment2_[i] / bias2) + kEpsilon);
            gradient_[i] = 0.0;
        }
        // Adam makes full steps even if the gradient is only noise.
        if (!unobserved_.empty()) move = remove_unobserved(move, unobserved_[pose]);
        for (std::size_t k = 0; k < 6; ++k) values_[6 * pose + k] += move[k];
    }
}

void TrackCorrection::remove_mean_motion() {
    // Corrections are [tx ty tz rx ry rz]. For small angles, the motion (t, r) about the
    // centre c of the track moves a pose at p by t + r x (p - c), and rotates it by r.
    const auto n = double(track_.pose.size());
    glm::dvec3 centre(0.0), mean_translation(0.0), mean_rotation(0.0);
    for (std::size_t k = 0; k < track_.pose.size(); ++k) {
        centre += track_.pose[k].translation / n;
        mean_translation += three_components(stored_correction(k), 0) / n;
        mean_rotation += three_components(stored_correction(k), 3) / n;
    }
    for (std::size_t k = 0; k < track_.pose.size(); ++k) {
        const glm::dvec3 translation =
            mean_translation + glm::cross(mean_rotation, track_.pose[k].translation - centre);
        for (int i = 0; i < 3; ++i) {
            values_[6 * k + std::size_t(i)] -= translation[i];
            values_[6 * k + 3 + std::size_t(i)] -= mean_rotation[i];
        }
    }
}

/// Prepares the corrections that train.refine_poses selects: of the sensor poses, which
/// need the gradients of rays, and of the actors' boxes, which need those of instances.
PoseRefiner::PoseRefiner(Device& device, const Log& log, const Scene& layout, const TrainConfig& config,
                         const TrainingFrames& frames, std::vector<std::vector<UnobservedMotion>> unobserved)
    : config_(config),
      is_active_(config.refine_poses != "none"),
      frames_(frames),
      layout_(strip_surfels(layout)),
      poses_(copy_without_scans(log)) {
    if (config.refines("sensor")) {
        sensor_.emplace(log.world_from_vehicle, std::move(unobserved));
        rays_.emplace(device, frames.all());
        sensor_readback_.emplace(device, rays_->partial_sums().size(), "pose gradients of rays");
    }
    if (!config.refines("actors")) return;
    for (std::size_t i = 0; i < layout_.instances.size(); ++i) {
        if (const BoxTrack* box = find_box(log, layout_.instances[i].track))
            actors_.push_back({i, std::size_t(box - log.boxes.data()), TrackCorrection(box->world_from_box)});
    }
    if (actors_.empty()) return;
    // 6 values per instance: rotation and translation
    instance_readback_.emplace(device, 6 * layout_.instances.size(), "pose gradients of instances");
}

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

DelayedReadback::DelayedReadback(Device& device, std::size_t n_floats, const char* text)
    : n_floats_(n_floats) {
    while (int(buffers_.size()) < kReadbackLag) buffers_.emplace_back(device, n_floats * sizeof(float), text);
}

void DelayedReadback::record_copy(Stream& stream, const Buffer& source, int step) {
    buffers_[std::size_t(step) % kReadbackLag].record_copy(stream, source, n_floats_ * sizeof(float));
}

void DelayedReadback::read(Stream& stream, int step, std::vector<float>& values) {
    if (!values.empty()) return;
    const void* bytes = buffers_[std::size_t(step) % kReadbackLag].wait_for_bytes(stream);
    values.assign(static_cast<const float*>(bytes), static_cast<const float*>(bytes) + n_floats_);
}

void PoseRefiner::record_gradients(Stream& stream, std::size_t frame_index, const TrainingFrameData& frame,
                                   const SampledBatch& batch, const DeviceGradients& gradients, int step) {
    if (!is_enabled()) return;
    if (rays_) {
        rays_->record_sums(stream, frame, batch, gradients.rays);
        sensor_readback_->record_copy(stream, rays_->partial_sums().buffer(), step);
    }
    if (instance_readback_) instance_readback_->record_copy(stream, gradients.poses.buffer(), step);
    // Needed by apply_gradients() when the host has read the gradients of this step.
    PendingPoseGradients& pending = pending_.emplace_back();
    pending.step = step;
    pending.frame = frame_index;
    for (const RefinedActor& actor : actors_) {
        // First and last time at which the sweep observes the actor.
        const InstancePose& placed = frame.placed[actor.instance];
        pending.actor_time_s.push_back(placed.time_s - placed.motion.half_span_s);
        pending.actor_time_s.push_back(placed.time_s + placed.motion.half_span_s);
    }
}

/// Copies the gradients of a pending iteration from the device. Waits for them.
void PoseRefiner::read_gradients(Stream& stream, PendingPoseGradients& pending) {
    if (sensor_readback_) sensor_readback_->read(stream, pending.step, pending.of_sensor);
    if (instance_readback_) instance_readback_->read(stream, pending.step, pending.of_instances);
}

void PoseRefiner::wait_for_pending(Stream& stream) {
    for (PendingPoseGradients& pending : pending_) read_gradients(stream, pending);
}

/// Updates the poses of the sensor and of the actors' boxes by one step of Adam each.
void PoseRefiner::apply_gradients(const PendingPoseGradients& pending) {
    if (rays_) {
        const TrainingFrameData& frame = frames_.all()[pending.frame];
        const std::vector<Twist> gradients = rays_->sum_gradients(pending.of_sensor, frame.n_knots);
        // The poses of the frame are knots, a range of the poses of the track.
        for (std::size_t k = 0; k < gradients.size(); ++k)
            sensor_->add_gradient(frame.first_knot + k, 1.0, gradients[k]);
        sensor_->run_adam_step(pose_rates(config_, config_.pose_rate_m, pending.step));
        sensor_->remove_mean_motion();  // which the rays do not determine
    }
    for (std::size_t k = 0; k < actors_.size(); ++k) {
        RefinedActor& actor = actors_[k];
        // The pose of an actor in a sweep is the mean of its poses at the first and the
        // last time at which the sweep observes it. Each of them gets half of the
        // gradient. An absent actor has the gradient zero, which add_gradient() ignores.
        Twist half_gradient;
        for (std::size_t i = 0; i < 6; ++i)
            half_gradient[i] = 0.5 * pending.of_instances[6 * actor.instance + i];
        for (std::size_t end = 0; end < 2; ++end)
            actor.correction.add_gradient(pending.actor_time_s[2 * k + end], half_gradient);
        actor.correction.run_adam_step(pose_rates(config_, kBoxFactor * config_.pose_rate_m, pending.step));
    }
}

void PoseRefiner::apply_until(Stream& stream, int last_step) {
    if (pending_.empty() || pending_.front().step > last_step) return;
    while (!pending_.empty() && pending_.front().step <= last_step) {
        read_gradients(stream, pending_.front());
        apply_gradients(pending_.front());
        pending_.pop_front();
    }
    update_corrected();
}

/// Joins the pending iterations to the flat arrays of a checkpoint. Each iteration
/// appends its gradients of the sensor poses, followed by those of the instances.
PoseRefiner::PendingArrays PoseRefiner::join_pending() const {
    PendingArrays arrays;
    const auto append = [](auto& array, const auto& values) {
        array.insert(array.end(), values.begin(), values.end());
    };
    for (const PendingPoseGradients& pending : pending_) {
        arrays.step.push_back(std::uint64_t(pending.step));
        arrays.frame.push_back(pending.frame);
        append(arrays.actor_time_s, pending.actor_time_s);
        append(arrays.gradient, pending.of_sensor);
        append(arrays.gradient, pending.of_instances);
    }
    return arrays;
}

/// Restores the pending iterations from the arrays of join_pending(). All iterations have
/// equally many values in each array, none for poses that are not corrected.
void PoseRefiner::split_pending(const PendingArrays& arrays) {
    const std::size_t n_times = 2 * actors_.size(),
                      n_sensor = sensor_readback_ ? sensor_readback_->n_floats() : 0,
                      n_instance = instance_readback_ ? instance_readback_->n_floats() : 0;
    pending_.clear();
    for (std::size_t i = 0; i < arrays.step.size(); ++i) {
        const double* times_s = arrays.actor_time_s.data() + i * n_times;
        const float* of_sensor = arrays.gradient.data() + i * (n_sensor + n_instance);
        const float* of_instances = of_sensor + n_sensor;
        pending_.push_back({.step = int(arrays.step[i]),
                            .frame = arrays.frame[i],
                            .actor_time_s = {times_s, times_s + n_times},
                            .of_sensor = {of_sensor, of_instances},
                            .of_instances = {of_instances, of_instances + n_instance}});
    }
}

void PoseRefiner::update_corrected() {
    if (sensor_) poses_.world_from_vehicle = sensor_->corrected_track();
    for (const RefinedActor& actor : actors_)
        poses_.boxes[actor.box].world_from_box = actor.correction.corrected_track();
}

}  // namespace relidar
