// SPDX-License-Identifier: Apache-2.0
// Motion of the sensor and of the instances during a scan. Private to simulate.
#pragma once

#include <relidar/scene/scene.hpp>

namespace relidar {

struct RenderedScan;

struct RayMotion {
    glm::dvec3 start_m, direction;
    double sensor_away_mps;  ///< speed of the ray's origin in the direction of the ray
};

struct MotionDuringScan {
    PoseTrack world_from_sensor;       ///< in relidar's world frame
    std::vector<InstancePose> placed;  ///< [instances] poses and motions

    /// Returns a ray in the world frame. Its origin moves with the sensor. The rotation
    /// of the LiDAR head does not move it.
    RayMotion motion_of_ray(const RenderedScan& scan, std::size_t ray) const;
    /// Returns the velocity of a point of an instance in m/s; 0 if the index is -1.
    /// Ignores the limbs of a walking actor.
    /// @param after_s time after the reference time of the scan
    glm::dvec3 object_velocity(std::int32_t instance, double after_s, const glm::dvec3& point_m) const;
};

}  // namespace relidar
