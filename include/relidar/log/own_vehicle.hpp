// SPDX-License-Identifier: Apache-2.0
// The vehicle that carries the sensors of a rig. Its body blocks rays, or rays return
// from it.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include <relidar/base/math.hpp>
#include <relidar/log/body_table.hpp>

namespace relidar {

/// A box of the body.
struct VehicleBox {
    Pose frame_from_box;  ///< pose of the centre of the box
    glm::dvec3 size_m{0.0};
};

/// What blocks the rays of a sensor: boxes, and the body that a LiDAR has seen.
struct VehicleBody {
    std::vector<VehicleBox> boxes;  ///< in the frame of the sensor
    /// True: points in the boxes are kept, with the class `ego`. False: rays that hit a
    /// box are dropped.
    bool keeps_points = false;
    BodyTable seen = {};
    glm::dquat seen_from_sensor{1.0, 0.0, 0.0, 0.0};  ///< rotates directions to the frame of `seen`

    bool empty() const { return boxes.empty() && seen.empty(); }
};

/// The vehicle of a rig. Its frame base_link is the middle of the rear axle on the
/// ground: x forward, y left, z up.
struct OwnVehicle {
    Pose rig_from_base_link = {};
    std::vector<VehicleBox> boxes = {};  ///< in the frame base_link
    bool keeps_points = false;           ///< as in VehicleBody
    bool is_of_log = false;              ///< the body that the log's LiDAR sees; without boxes
    std::string json = {};               ///< text of the rig's file
};

/// Instance of a ray that hits the own vehicle (RenderedScan::instance).
inline constexpr int kOwnVehicleInstance = -2;

/// Returns the body of a vehicle in the frame of a sensor.
VehicleBody place_body(const OwnVehicle& vehicle, const Pose& rig_from_sensor);

/// A point at which a ray enters a box.
struct BodyHit {
    double range_m;     ///< distance from the start of the ray
    glm::dvec3 normal;  ///< outward unit normal of the side, in the frame of the ray
};
/// Returns the first point at which a ray enters a box. A box that contains the start of
/// the ray does not block it, because a sensor can be inside the outline of the vehicle.
/// @param origin_m [3] start of the ray, in the frame of the boxes
/// @param direction [3] unit vector
std::optional<BodyHit> find_body_hit(std::span<const VehicleBox> boxes, const glm::dvec3& origin_m,
                                     const glm::dvec3& direction);

}  // namespace relidar
