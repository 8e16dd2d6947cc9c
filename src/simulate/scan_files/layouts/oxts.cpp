// SPDX-License-Identifier: Apache-2.0
#include "simulate/scan_files/layouts/oxts.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

namespace relidar::layouts {
namespace {

constexpr double kEarthRadius_m = 6378137.0, kDegrees = 180.0 / kPi;
constexpr GeodeticPosition kUnknownPlace{49.0, 8.4, 110.0};  // Karlsruhe

/// Position of the first pose, and the rotation to axes that point east, north and up.
struct FirstPlace {
    GeodeticPosition position = kUnknownPlace;
    glm::dquat enu_from_world{1.0, 0.0, 0.0, 0.0};
};

FirstPlace find_first_place(const glm::dvec3& first_m, const std::optional<Georeference>& place) {
    if (!place) return {};
    if (has_proj()) {
        const GeoConverter converter(*place);
        const GeodeticPosition position = converter.to_geodetic(first_m);
        return {position, glm::conjugate(converter.dataset_from_enu(position))};
    }
    const glm::dvec3 moved_m = place->rotation * (first_m - place->point_m);
    const double latitude_rad = place->position.latitude_deg / kDegrees;
    return {{place->position.latitude_deg + kDegrees * moved_m.y / kEarthRadius_m,
             place->position.longitude_deg + kDegrees * moved_m.x / (kEarthRadius_m * std::cos(latitude_rad)),
             place->position.height_m + moved_m.z},
            place->rotation};
}

}  // namespace

std::string format_oxts(const std::vector<Pose>& world_from_imu, const std::vector<double>& times_s,
                        const std::optional<Georeference>& place) {
    std::string text;
    if (world_from_imu.empty()) return text;
    const glm::dvec3 first_m = world_from_imu.front().translation;
    const FirstPlace first = find_first_place(first_m, place);
    const double first_latitude_rad = first.position.latitude_deg / kDegrees,
                 radius_m = std::cos(first_latitude_rad) * kEarthRadius_m,
                 first_north = std::log(std::tan(0.25 * kPi + 0.5 * first_latitude_rad));
    for (std::size_t i = 0; i < world_from_imu.size(); ++i) {
        const glm::dvec3 moved_m = first.enu_from_world * (world_from_imu[i].translation - first_m);
        const double latitude_rad = 2.0 * std::atan(std::exp(first_north + moved_m.y / radius_m)) - 0.5 * kPi;
        const glm::dmat3 axes = glm::mat3_cast(first.enu_from_world * world_from_imu[i].rotation);
        const std::size_t before = i == 0 ? 0 : i - 1, after = std::min(i + 1, world_from_imu.size() - 1);
        glm::dvec3 velocity(0.0);  // east, north, up
        if (after > before)
            velocity = first.enu_from_world *
                       (world_from_imu[after].translation - world_from_imu[before].translation) /
                       (times_s[after] - times_s[before]);
        const glm::dvec3 body_velocity = velocity * axes;  // forward, left, up
        // Accelerations, angular rates, accuracies, and the state of a receiver with GPS.
        constexpr const char* kRest = "0 0 0 0 0 0 0 0 0 0 0 0 0.01 0.01 4 10 4 4 4";
        text += fmt::format(
            "{:.15g} {:.15g} {:.6f} {:.12g} {:.12g} {:.12g} {:.6f} {:.6f} {:.6f} {:.6f} {:.6f} {}\n",
            latitude_rad * kDegrees, first.position.longitude_deg + kDegrees * moved_m.x / radius_m,
            first.position.height_m + moved_m.z, std::atan2(axes[1].z, axes[2].z), std::asin(-axes[0].z),
            std::atan2(axes[0].y, axes[0].x), velocity.y, velocity.x, body_velocity.x, body_velocity.y,
            body_velocity.z, kRest);
    }
    return text;
}

}  // namespace relidar::layouts
