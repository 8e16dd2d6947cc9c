// SPDX-License-Identifier: Apache-2.0
// The smooth path of a thing that was seen at noisy places, and where it heads. Private
// to scene.
#pragma once

#include <vector>

#include <glm/glm.hpp>

namespace relidar {

/// Where something is at a time, and how it moves.
struct PathState {
    glm::dvec3 position_m, velocity_mps, acceleration_mps2;
    glm::dvec3 after(double seconds) const {
        return position_m + seconds * (velocity_mps + 0.5 * seconds * acceleration_mps2);
    }
};

/// The path over the whole track that is near the places and whose acceleration changes
/// little (a smoothing spline of the fifth degree, docs/method.md section 6). Places far
/// from it count little.
/// @param time_s ascending @param place_m [times] @return [times]
std::vector<PathState> smooth_path(const std::vector<double>& time_s, const std::vector<glm::dvec3>& place_m);

/// Headings along a path on the ground, radians: from where it was 1.5 m before to where
/// it is 1.5 m later, so that what stands keeps the heading with which it came.
/// @param path_m [places] @return [places]
std::vector<double> headings_along(const std::vector<glm::dvec3>& path_m);

}  // namespace relidar
