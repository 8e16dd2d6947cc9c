// SPDX-License-Identifier: Apache-2.0
// Pose refinement: gradients of rays and of instances become steps of the poses between which they are interpolated.
#include "train/pose_refiner.hpp"

#include <algorithm>

#include <relidar/backward.hpp>
#include <relidar/optimizer.hpp>
#include <relidar/train.hpp>

#include "train/moved_rays.hpp"

namespace relidar {
namespace {

constexpr double kFinalShare = 0.1;   // of the rates, at the end of training

Sequence without_scans(const Sequence& sequence) {
    Sequence result;
    result.sensor = sequence.sensor;
    result.world_from_sensor = sequence.world_from_sensor;
    result.boxes = sequence.boxes;
    result.rolling_shutter = sequence.rolling_shutter;
    for (const Frame& frame : sequence.frames) result.frames.push_back({frame.index, frame.time_s, {}});
    return result;
}

bool wants(const TrainConfig& config, const char* word) { return config.refine_poses.find(word) != std::string::npos; }

PoseStep step_at(const TrainConfig& c, double rate_m, double rate_rad, int step) {
    const double decay = exponential_schedule(1.0, kFinalShare, step, c.iterations);
    return {rate_m * decay, rate_rad * decay, c.pose_prior_per_m2, c.pose_prior_per_rad2};
}

}  // namespace

PoseRefiner::PoseRefiner(Device& device, const Sequence& sequence, const Scene& layout, const TrainConfig& config, std::vector<FrameData>& frames)
    : config_(config), layout_(layout_of(layout)), poses_(without_scans(sequence)) {
    if (wants(config, "sensor")) {
        sensor_.emplace(sequence.world_from_sensor);
        rays_ = std::make_unique<MovedRays>(device, sequence, frames);
    }
    if (!wants(config, "actors")) return;
    for (std::size_t i = 0; i < layout_.instances.size(); ++i) {
        const auto box = std::find_if(sequence.boxes.begin(), sequence.boxes.end(), [&](const BoxTrack& b) { return b.id == layout_.instances[i].track; });
        if (box != sequence.boxes.end()) actors_.push_back({i, std::size_t(box - sequence.boxes.begin()), TrackCorrection(box->world_from_box)});
    }
}

PoseRefiner::~PoseRefiner() = default;

RefinedPoses PoseRefiner::poses() const { return {poses_.world_from_sensor, poses_.boxes}; }

WantedGradients PoseRefiner::wanted(std::uint32_t largest_batch) const { return {sensor_ ? largest_batch : 0u, !actors_.empty()}; }

void PoseRefiner::place(Stream& stream, std::size_t frame_index, FrameData& frame) {
    if (rays_) rays_->move(stream, *sensor_, frame_index, frame);
    const double time_s = poses_.frames[std::size_t(frame.position)].time_s;
    frame.placed = place_instances(layout_, poses_, time_s);
    frame.sensor_position_m = glm::vec3(poses_.world_from_sensor.at(time_s).translation);
}

void PoseRefiner::step(Stream& stream, std::size_t frame_index, const FrameData& frame, const SampledBatch& batch, const Gradients& gradients, int step) {
    if (step <= config_.pose_from) return;
    if (rays_) {
        for (const PoseGradient& g : rays_->gradients(stream, frame_index, batch, gradients.rays)) sensor_->add_gradient(g.pose, 1.0, g.gradient);
        sensor_->step(step_at(config_, config_.pose_rate_m, config_.pose_rate_rad, step));
        sensor_->remove_common_motion();
    }
    if (!actors_.empty()) {
        stream.finish();
        const std::vector<float> of_instances = gradients.poses.download();
        for (Actor& actor : actors_) {
            const InstancePose& placed = frame.placed[actor.instance];
            Twist gradient;
            std::copy_n(of_instances.begin() + std::ptrdiff_t(6 * actor.instance), 6, gradient.begin());
            if (placed.present) actor.correction.add_gradient(placed.time_s, gradient);
            actor.correction.step(step_at(config_, config_.box_rate_m, config_.box_rate_rad, step));
        }
    }
    update_poses();
}

void PoseRefiner::update_poses() {
    if (sensor_) poses_.world_from_sensor = sensor_->corrected();
    for (const Actor& actor : actors_) poses_.boxes[actor.box].world_from_box = actor.correction.corrected();
}

bool PoseRefiner::take_over() {
    const bool sound = (!sensor_ || sensor_->is_sound()) && std::all_of(actors_.begin(), actors_.end(), [](const Actor& a) { return a.correction.is_sound(); });
    if (sound) update_poses();
    return sound;
}

}  // namespace relidar
