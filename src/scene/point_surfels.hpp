// SPDX-License-Identifier: Apache-2.0
// Surfels from points: normals and scales from nearest neighbours (docs/method.md section 2). What the background and every actor
// share; private to scene.
#pragma once

#include <vector>

#include <relidar/scene.hpp>

namespace relidar {

/// A point of the log: where, how bright, and from where it was seen. World, or the frame of an actor's box.
struct Sample {
    glm::vec3 position;
    float intensity;
    glm::vec3 view;   ///< unit, sensor to point
};

/// One surfel a sample, in kd order. Where normals are found, intensity starts with the fall with incidence of the log's surfaces.
/// @param samples at least one @param incidence of IntensityResponse
Surfels surfels_from_points(const std::vector<Sample>& samples, const InitialiseOptions& options, double incidence,
                            const Progress& progress = {});

}  // namespace relidar
