// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/own_vehicle.hpp>

#include <cmath>
#include <limits>

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
        // The ray is in the box while it is between both planes of each pair of sides.
        double enter_m = 0.0, leave_m = std::numeric_limits<double>::infinity();
        int side = -1;
        for (int k = 0; k < 3; ++k) {
            const double half_m = 0.5 * box.size_m[k];
            if (way[k] == 0.0) {
                // A ray that is parallel to these sides must be between them.
                if (std::abs(start[k]) > half_m) leave_m = -1.0;
                continue;
            }
            const double near_m = (-std::copysign(half_m, way[k]) - start[k]) / way[k],
                         far_m = (std::copysign(half_m, way[k]) - start[k]) / way[k];
            if (near_m > enter_m) {
                enter_m = near_m;
                side = k;
            }
            leave_m = std::min(leave_m, far_m);
        }
        // The side is -1 if the ray starts in the box, or if the box is behind it.
        if (side < 0 || enter_m > leave_m || (first && first->range_m <= enter_m)) continue;
        glm::dvec3 normal(0.0);
        normal[side] = -std::copysign(1.0, way[side]);
        first = BodyHit{enter_m, box.frame_from_box.rotation * normal};
    }
    return first;
}

}  // namespace relidar
