// SPDX-License-Identifier: Apache-2.0
// Smooths the noisy observed positions of an object. Computes the object's headings from
// the smooth path. Private to scene.
#pragma once

#include <vector>

#include <glm/glm.hpp>

namespace relidar {

struct KinematicState {
    glm::dvec3 position_m, velocity_mps, acceleration_mps2;
    glm::dvec3 position_after(double seconds) const {
        return position_m + seconds * (velocity_mps + 0.5 * seconds * acceleration_mps2);
    }
};
using KinematicPath = std::vector<KinematicState>;

/// Fits a smooth path through the observed positions of a track at ascending times. The
/// path is a smoothing spline of the fifth degree that penalizes changes of the
/// acceleration (docs/method.md section 6). Positions far from it get a low weight.
KinematicPath smooth_path(const std::vector<double>& times_s, const std::vector<glm::dvec3>& positions_m);

/// Returns the heading in radians at each position of a path on the ground: the direction
/// from the point 1.5 m earlier on the path to the point 1.5 m later. An object that
/// stops therefore keeps its last heading.
std::vector<double> path_headings_rad(const std::vector<glm::dvec3>& path_m);

}  // namespace relidar
