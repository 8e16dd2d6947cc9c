// SPDX-License-Identifier: Apache-2.0
#include "simulate/render/sunlight.hpp"

#include <algorithm>
#include <cmath>

#include <relidar/base/math.hpp>

namespace relidar {
namespace {

// Surfaces hide the sun if their accumulated alpha is at least this value.
constexpr float kHidesSun = 0.5f;

}  // namespace

glm::dvec3 direction_of(const Sun& sun) {
    const double azimuth = sun.azimuth_deg * kPi / 180.0, elevation = sun.elevation_deg * kPi / 180.0;
    return {std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth),
            std::sin(elevation)};
}

std::vector<float> angles_from_sun(const RenderedScan& scan, const Sun& sun, const glm::dvec3& world_offset_m,
                                   Renderer& renderer) {
    if (sun.klux == 0.0) return {};
    const glm::dvec3 to_sun = direction_of(sun);
    WorldRays sight;
    sight.origin.push_back(glm::vec3(scan.world_from_sensor.translation - world_offset_m));
    sight.direction.push_back(glm::vec3(to_sun));
    if (renderer.forward(sight).weight[0] >= kHidesSun) return {};
    std::vector<float> angles;
    FiringPoses firing(scan);
    for (std::size_t i = 0; i < scan.image.direction.size(); ++i) {
        const glm::dvec3 direction = firing.at(i).rotation * glm::dvec3(scan.image.direction[i]);
        angles.push_back(static_cast<float>(std::acos(std::clamp(glm::dot(direction, to_sun), -1.0, 1.0))));
    }
    return angles;
}

}  // namespace relidar
