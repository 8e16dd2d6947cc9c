// SPDX-License-Identifier: Apache-2.0
// Scenes and rays for benchmarks.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <relidar/diff/traversal.hpp>
#include <relidar/run/run.hpp>

namespace relidar::cli {

/// A scene, the rays cast into it, and the settings of its kernels.
struct BenchCase {
    std::string name;  ///< "benchmark street", or the run's folder and the frame number.
    Scene scene;
    Config config;
    WorldRays rays;
    int rows = 0;
    int columns = 0;
    glm::vec3 view_origin_m{0.0f};
    std::vector<InstancePose> placed;  ///< [instances] pose of each instance.
};

/// Creates the benchmark street with the settings of the paper.
/// @param refined see make_benchmark_street()
BenchCase make_street_case(std::uint32_t n_surfels, bool refined, const RayTable& rays);

/// Creates a case from a run: its scene, seen by its sensor at the first held-out frame.
/// @throws DataError for a run without frames or surfels
BenchCase make_run_case(const Run& run);

}  // namespace relidar::cli
