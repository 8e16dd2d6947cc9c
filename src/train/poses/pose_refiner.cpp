// SPDX-License-Identifier: Apache-2.0
#include "train/poses/pose_refiner.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include <relidar/diff/backward.hpp>
#include <relidar/diff/optimizer.hpp>
#include <relidar/train/train.hpp>

#include "base/assert.hpp"
#include "gpu/stream.hpp"
#include "train/frames/training_frames.hpp"
#include "train/iteration_reports.hpp"

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

PoseCorrectedRays::PoseCorrectedRays(Device& device, const std::vector<TrainingFrameData>& frames)
    : most_knots_(max_frame_poses(frames)),
      moved_(device, max_frame_rays(frames), "moved rays"),
      knots_(device, most_knots_, "sensor poses"),
      rows_(device, std::size_t(kGroupsPerPose) * 6 * most_knots_, "pose gradients"),
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

/// Records GPU commands that sum the gradients of the rays for each pose of the frame
/// (knot). A pose has kGroupsPerPose workgroups, each of which writes one partial sum.
void PoseCorrectedRays::record_sums(Stream& stream, const TrainingFrameData& frame, const SampledBatch& batch,
                                    const Array<float, shared::DeviceRayGradients>& ray_gradients) {
    RELIDAR_ASSERT_LE(std::size_t(6) * batch.rays.n_rays, ray_gradients.size());
    run(stream, gradients_, std::size_t(RELIDAR_KNOT_WORKGROUP) * kGroupsPerPose * most_knots_,
        {.moved = batch.rays.rays->address(),
         .interpolations = frame.arrays->track_positions.address(),
         .knots = knots_.address(),
         .d_rays = ray_gradients.address(),
         .rows = rows_.address(),
         .n_rays = batch.rays.n_rays,
         .first_ray = batch.rays.first,
         .ray_stride = batch.rays.stride,
         // Columns of the batch in the frame. If `columns` is 0, it has every n-th ray.
         .columns = batch.window.columns,
         .first_column = batch.window.first,
         .column_stride = batch.window.stride,
         .n_columns = batch.window.n_columns,
         .n_knots = most_knots_,
         .n_rows = kGroupsPerPose});
}

/// Adds the rows of partial sums on the host, which gives one gradient per pose.
std::vector<PoseGradient> PoseCorrectedRays::sum_gradients(std::span<const float> sums,
                                                           const TrainingFrameData& frame) const {
    std::vector<PoseGradient> result(frame.n_knots);
    for (std::size_t knot = 0; knot < result.size(); ++knot) {
        result[knot].pose = frame.first_knot + knot;
        for (std::size_t row = 0; row < kGroupsPerPose; ++row)
            for (std::size_t i = 0; i < 6; ++i)
                result[knot].gradient[i] += sums[6 * (row * most_knots_ + knot) + i];
    }
    return result;
}

TrackCorrection::TrackCorrection(PoseTrack track)
    : track_(std::move(track)),
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
    // The nearest corrected poses before and after, or the ends of the track.
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
        for (std::size_t k = 0; k < 6; ++k) {
            const std::size_t i = 6 * pose + k;
            const bool is_translation = k < 3;
            const double rate = is_translation ? step_rates.rate_m : step_rates.rate_rad;
            const double prior = is_translation ? step_rates.prior_per_m2 : step_rates.prior_per_rad2;
            // The prior is prior * value^2.
            const double gradient = gradient_[i] + 2.0 * prior * values_[i];
            moment1_[i] += (1.0 - kBeta1) * (gradient - moment1_[i]);
            moment2_[i] += (1.0 - kBeta2) * (gradient * gradient - moment2_[i]);
            values_[i] -= rate * (moment1_[i] / bias1) / (std::sqrt(moment2_[i] / bias2) + kEpsilon);
            gradient_[i] = 0.0;
        }
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
    // The host reads these copies kReadbackLag iterations later, from their own buffers.
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
        // First and last time at which the sweep observes the actor, because the
        // gradients of an actor are divided between its poses at these times.
        const InstancePose& placed = frame.placed[actor.instance];
        pending_iterations_.actor_time_s.push_back(placed.time_s - placed.motion.half_span_s);
        pending_iterations_.actor_time_s.push_back(placed.time_s + placed.motion.half_span_s);
    }
    // Space for the gradients, which wait_for_gradient() copies when they are available.
    pending_iterations_.gradient.resize(pending_iterations_.gradient.size() + floats_of_rays_ +
                                        floats_of_instances_);
}

std::span<float> PoseRefiner::wait_for_gradient(Stream& stream, std::size_t pending_index) {
    const std::size_t n_floats = floats_of_rays_ + floats_of_instances_;
    const std::size_t slot = pending_iterations_.step[pending_index] % kReadbackLag;
    const std::span<float> gradient(pending_iterations_.gradient.data() + pending_index * n_floats, n_floats);
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
        const TrainingFrameData& frame = frames_.all()[pending_iterations_.frame.front()];
        for (const PoseGradient& pose : rays_->sum_gradients(gradient.first(floats_of_rays_), frame))
            sensor_->add_gradient(pose.pose, 1.0, pose.gradient);
        sensor_->run_adam_step(pose_rates(config_, config_.pose_rate_m, step));
        sensor_->remove_mean_motion();
    }
    apply_actor_gradients(gradient.subspan(floats_of_rays_), step);
    remove_first(pending_iterations_.step, 1);
    remove_first(pending_iterations_.frame, 1);
    remove_first(pending_iterations_.actor_time_s, 2 * actors_.size());
    remove_first(pending_iterations_.gradient, floats_of_rays_ + floats_of_instances_);
}

/// Updates the boxes of the actors with the gradients of the oldest pending iteration.
/// @param instance_gradients [instances, 6]
void PoseRefiner::apply_actor_gradients(std::span<const float> instance_gradients, int step) {
    for (std::size_t k = 0; k < actors_.size(); ++k) {
        RefinedActor& actor = actors_[k];
        Twist twist;
        std::copy_n(instance_gradients.begin() + std::ptrdiff_t(6 * actor.instance), 6, twist.begin());
        // The pose of the actor is the mean of its poses at the first and the last time
        // at which a sweep observes it. Each of these two poses gets half of the
        // gradient.
        for (double& component : twist) component *= 0.5;
        // The actor may be absent from the frame. Its gradient is then zero, and
        // add_gradient() ignores zero gradients.
        for (std::size_t end = 0; end < 2; ++end)
            actor.correction.add_gradient(pending_iterations_.actor_time_s[2 * k + end], twist);
        actor.correction.run_adam_step(pose_rates(config_, kBoxFactor * config_.pose_rate_m, step));
    }
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
