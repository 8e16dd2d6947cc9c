// SPDX-License-Identifier: Apache-2.0
#include "simulate/render/scan_motion.hpp"

#include <relidar/simulate/render.hpp>

namespace relidar {

RayMotion MotionDuringScan::motion_of_ray(const RenderedScan& scan, std::size_t ray) const {
    // half of the time span of the central difference
    constexpr double kVelocityStep_s = 0.005;
    const double time_s = scan.time_s + double(scan.time_offset_s[ray]);
    const Pose world_from_firing = world_from_sensor.pose_at(time_s);
    const glm::dvec3 origin_m(scan.image.origin[ray]);
    RayMotion motion{world_from_firing * origin_m,
                     world_from_firing.rotation * glm::dvec3(scan.image.direction[ray]), 0.0};
    // With a single pose the sensor rests, and its speed stays 0.
    if (world_from_sensor.pose.size() > 1)
        motion.sensor_away_mps =
            glm::dot(motion.direction, world_from_sensor.pose_at(time_s + kVelocityStep_s) * origin_m -
                                           world_from_sensor.pose_at(time_s - kVelocityStep_s) * origin_m) /
            (2.0 * kVelocityStep_s);
    return motion;
}

glm::dvec3 MotionDuringScan::object_velocity(std::int32_t instance, double after_s,
                                             const glm::dvec3& point_m) const {
    if (instance < 0 || std::size_t(instance) >= placed.size()) return glm::dvec3(0.0);
    const InstancePose& object = placed[std::size_t(instance)];
    // velocity of a rigid body: translation plus rotation about its centre
    const glm::dvec3 middle_m = object.motion.pose_at(object.world_from_model, after_s).translation;
    return object.motion.velocity_mps + glm::cross(object.motion.angular_velocity_radps, point_m - middle_m);
}

FiringPoseInterpolator::FiringPoseInterpolator(const RenderedScan& scan, const Pose& target_from_dataset)
    : scan_(scan),
      target_from_dataset_(target_from_dataset),
      moves_(scan.track.pose.size() > 1),
      made_(moves_ && scan.image.rows > 1 ? std::size_t(scan.image.columns) : 1,
            {std::numeric_limits<float>::quiet_NaN(), {}}) {}

const Pose& FiringPoseInterpolator::pose_of(std::size_t ray) {
    CachedFiringPose& made = made_[ray % made_.size()];
    const float time_offset_s = moves_ ? scan_.time_offset_s[ray] : 0.0f;
    if (made.time_offset_s != time_offset_s)
        made = {time_offset_s, target_from_dataset_ * scan_.firing_pose(ray)};
    return made.target_from_firing;
}

}  // namespace relidar
