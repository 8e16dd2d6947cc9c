// SPDX-License-Identifier: Apache-2.0
// Makes a run for the tests of assets: a car that consists of plates, ahead of a LiDAR.
#pragma once

#include <cmath>
#include <random>

#include <relidar/simulate/assets.hpp>

#include "../plates.hpp"

namespace relidar {

inline const glm::dvec3 kCarSize_m(4.0, 2.0, 1.6);

inline Surfels make_random_surfels(std::size_t count, const glm::vec3& low_m, const glm::vec3& high_m,
                                   unsigned seed) {
    std::mt19937 random(seed);
    const auto between = [&](float low, float high) {
        return std::uniform_real_distribution<float>(low, high)(random);
    };
    Surfels surfels;
    surfels.resize(count);
    for (std::size_t i = 0; i < count; ++i) {
        for (int axis = 0; axis < 3; ++axis) surfels.mean[i][axis] = between(low_m[axis], high_m[axis]);
        for (int k = 0; k < 4; ++k) surfels.rotation[i][k] = between(-1.0f, 1.0f);
        surfels.log_scale[i] = {std::log(between(0.02f, 0.2f)), std::log(between(0.02f, 0.2f))};
        surfels.opacity_logit[i] = between(-1.0f, 4.0f);
        for (int k = 0; k < kShFloats; ++k) surfels.sh[i * kShFloats + std::size_t(k)] = between(-0.4f, 0.4f);
    }
    return surfels;
}

inline ActorObservations from_outside(const std::vector<glm::vec3>& points_m, double nearest_m = 8.0) {
    ActorObservations sightings{points_m, {}, nearest_m};
    for (const glm::vec3& point_m : points_m) sightings.directions.push_back(-glm::normalize(point_m));
    return sightings;
}

/// Three frames with a LiDAR at the origin and a static car.
inline Run run_of(Surfels car, const Pose& world_from_car) {
    Run run;
    const auto n = std::uint32_t(car.size());
    run.scene.surfels = std::move(car);
    run.scene.models = {{"background", 0, 0, {}}, {"7", 0, n, glm::vec3(0.5 * kCarSize_m + 0.1)}};
    run.scene.instances = {{0, ""}, {1, "7"}};
    Log& log = run.log;
    log.lidars[0].sensor = {"small", {}, 720};
    for (int i = 0; i < 24; ++i) log.lidars[0].sensor.beams.push_back({(4.0 - i) * kPi / 180.0});
    log.lidars[0].sensor.first_azimuth_rad = kPi;
    log.world_offset_m = {455000.0, 5428000.0, 113.0};
    for (int i = 0; i < 3; ++i) {
        log.frames.push_back({i, 0.5 * i, {}});
        log.world_from_vehicle.time_s.push_back(0.5 * i);
        log.world_from_vehicle.pose.push_back({});
    }
    log.boxes = {{"7", "Car", kCarSize_m, {{0.0, 1.0}, {world_from_car, world_from_car}}}};
    run.split = {{0, 2}, {1}};
    return run;
}

/// Opaque plates on the four sides of the car, 5 cm inside its box.
inline Surfels make_plates() {
    Surfels surfels;
    const auto add = [&](const glm::vec3& at_m, const glm::quat& turn) {
        surfels.append_surfels(test::make_plate(at_m, glm::vec2(0.12f)));
        surfels.rotation.back() = {turn.w, turn.x, turn.y, turn.z};
    };
    const glm::quat along_x(std::sqrt(0.5f), 0.0f, std::sqrt(0.5f), 0.0f),
        along_y(std::sqrt(0.5f), std::sqrt(0.5f), 0.0f, 0.0f);
    for (float z_m = -0.7f; z_m < 0.75f; z_m += 0.2f) {
        for (float y_m = -0.9f; y_m < 0.95f; y_m += 0.2f) {
            add({1.95f, y_m, z_m}, along_x);
            add({-1.95f, y_m, z_m}, along_x);
        }
        for (float x_m = -1.9f; x_m < 1.95f; x_m += 0.2f) {
            add({x_m, 0.95f, z_m}, along_y);
            add({x_m, -0.95f, z_m}, along_y);
        }
    }
    return surfels;
}

}  // namespace relidar
