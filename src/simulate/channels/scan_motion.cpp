// SPDX-License-Identifier: Apache-2.0
#include "simulate/channels/scan_motion.hpp"

#include <relidar/simulate/render.hpp>

namespace relidar {

RayMotion MotionDuringScan::motion_of_ray(const RenderedScan& scan, std::size_t ray) const {
    constexpr double kVelocityStep_s = 0.005;  // half of the time span of the central difference
    const double time_s = scan.time_s + double(scan.time_offset_s[ray]);
    const Pose world_from_firing = world_from_sensor.pose_at(time_s);
    const glm::dvec3 origin_m(scan.image.origin[ray]);
    RayMotion motion{.start_m = world_from_firing * origin_m,
                     .direction = world_from_firing.rotation * glm::dvec3(scan.image.direction[ray]),
                     .sensor_away_mps = 0.0};
    if (world_from_sensor.pose.size() == 1) return motion;  // the sensor rests
    const glm::dvec3 moved_m = world_from_sensor.pose_at(time_s + kVelocityStep_s) * origin_m -
                               world_from_sensor.pose_at(time_s - kVelocityStep_s) * origin_m;
    motion.sensor_away_mps = glm::dot(motion.direction, moved_m) / (2.0 * kVelocityStep_s);
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

}  // namespace relidar
