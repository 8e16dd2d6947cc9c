// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <relidar/diff/traversal.hpp>
#include <relidar/run/run.hpp>

namespace relidar::cli {

/// A scene and the rays with which its rendering is measured or checked.
struct BenchCase {
    std::string name;
    Scene scene;
    Config config;
    WorldRays rays;
    int rows = 0;
    int columns = 0;
    glm::vec3 view_origin_m{0.0f};
    std::vector<InstancePose> placed;  ///< [instances] pose of each instance.
};

/// Returns a synthetic street, with the settings of the LiDAR-RT paper.
BenchCase street_case(std::uint32_t n_surfels, bool smaller_scales_for_more_surfels, const RayTable& rays);

/// Returns the scene of a run, with the rays of its sensor at the first held-out frame.
/// @throws DataError if the run has no frames or no surfels
BenchCase case_of_run(const Run& run);

}  // namespace relidar::cli
