// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <functional>

#include <relidar/run/blocks.hpp>

namespace relidar::test {

/// Frames at intervals of 0.1 s. In frame i the vehicle is at path(i).
inline Log log_along(int count, const std::function<glm::dvec3(int)>& path) {
    Log log;
    log.name = "way";
    for (int i = 0; i < count; ++i) {
        log.frames.push_back({100 + i, 0.1 * i, {}});
        log.world_from_vehicle.time_s.push_back(0.1 * i);
        log.world_from_vehicle.pose.push_back({{1, 0, 0, 0}, path(i)});
    }
    return log;
}

/// Standard deviation of 1 m, facing along x. At each x, at intervals of 10 m along y.
inline Surfels make_walls_at(const std::vector<float>& xs) {
    Surfels surfels;
    surfels.resize(3 * xs.size());
    for (std::size_t i = 0; i < surfels.size(); ++i) {
        surfels.mean[i] = {xs[i / 3], -10.0f + 10.0f * float(i % 3), 0.5f};
        surfels.rotation[i] = {std::sqrt(0.5f), 0.0f, std::sqrt(0.5f), 0.0f};
        surfels.log_scale[i] = glm::vec2(0.0f);
        surfels.opacity_logit[i] = 6.0f;
        for (std::size_t k = 0; k < kShFloats; ++k) surfels.sh[i * kShFloats + k] = 0.0f;
        surfels.sh[i * kShFloats + kShCoefficients] = 20.0f;  // hit logit
        surfels.sh[i * kShFloats] = 0.01f * (xs[i / 3] - 100.0f) / 3.0f;
    }
    return surfels;
}

}  // namespace relidar::test
