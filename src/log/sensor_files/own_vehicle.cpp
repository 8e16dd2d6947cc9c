// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/own_vehicle.hpp>

#include <cmath>

#include "base/geometry/ray_box.hpp"

namespace relidar {

VehicleBody place_body(const OwnVehicle& vehicle, const Pose& rig_from_sensor) {
    VehicleBody body{{}, vehicle.keeps_points};
    for (const VehicleBox& box : vehicle.boxes)
        body.boxes.push_back(
            {inverse(rig_from_sensor) * vehicle.rig_from_base_link * box.frame_from_box, box.size_m});
    return body;
}

std::optional<BodyHit> find_body_hit(std::span<const VehicleBox> boxes, const glm::dvec3& origin_m,
                                     const glm::dvec3& direction) {
    std::optional<BodyHit> first;
    for (const VehicleBox& box : boxes) {
        const glm::dvec3 start = inverse(box.frame_from_box) * origin_m,
                         way = glm::conjugate(box.frame_from_box.rotation) * direction;
        const auto inside = cross_box(start, way, -0.5 * box.size_m, 0.5 * box.size_m);
        // A ray that starts in the box or behind it does not enter it ahead.
        if (!inside || inside->enter <= 0.0 || (first && first->range_m <= inside->enter)) continue;
        glm::dvec3 normal(0.0);
        normal[inside->axis] = -std::copysign(1.0, way[inside->axis]);
        first = BodyHit{inside->enter, box.frame_from_box.rotation * normal};
    }
    return first;
}

}  // namespace relidar
