// SPDX-License-Identifier: Apache-2.0
// Computes how fast the sensor and the objects move during a scan. Private to simulate.
#pragma once

#include <relidar/simulate/render.hpp>

namespace relidar {

struct RayMotion {
    glm::dvec3 start_m, direction;
    double sensor_away_mps;  ///< speed of the sensor along the ray
};

struct MotionDuringScan {
    PoseTrack world_from_sensor;       ///< in relidar's world frame
    std::vector<InstancePose> placed;  ///< [instances] poses and motions

    /// Returns a ray and the speed of its origin. The origin moves with the sensor. The
    /// rotation of the LiDAR head does not move it.
    RayMotion motion_of_ray(const RenderedScan& scan, std::size_t ray) const;
    /// Returns the velocity of a point of an instance in m/s; 0 if the index is -1.
    /// Ignores the limbs of a walking actor.
    /// @param after_s time after the reference time of the scan
    glm::dvec3 object_velocity(std::int32_t instance, double after_s, const glm::dvec3& point_m) const;
};

}  // namespace relidar
