// SPDX-License-Identifier: Apache-2.0
#include "log/frames/labelled_azimuth.hpp"

#include <cmath>

#include <nlohmann/json.hpp>

#include <relidar/log/camera.hpp>
#include "base/json_field.hpp"

namespace relidar {

AzimuthInterval view_azimuths(const Camera& camera) {
    const auto azimuth_rad = [&](double column) {
        const glm::dvec3 direction =
            camera.rig_from_camera.rotation * camera.direction_of({column, camera.centre_y_px});
        return std::atan2(direction.y, direction.x);
    };
    return {azimuth_rad(camera.columns - 1), azimuth_rad(0)};
}

nlohmann::ordered_json azimuths_json(const AzimuthInterval& azimuths) {
    return {azimuths.right_rad, azimuths.left_rad};
}

AzimuthInterval read_azimuths(const JsonField& field) {
    const auto v = field.numbers<2>();
    for (std::size_t i = 0; i < v.size(); ++i) field.at(i).number_in(-kPi, kPi);
    if (!(v[0] < v[1])) field.reject("found another order", "expected the right limit before the left one");
    return {v[0], v[1]};
}

}  // namespace relidar
